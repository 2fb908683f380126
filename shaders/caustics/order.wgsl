// Puts the photons of each cell into their order, so that sums over them have the same bits whatever came first.

@compute @workgroup_size(WORKGROUP)
fn order(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) invocation: u32,
) {
    let photon = number_of(group, groups, invocation);
    if photon >= sketch.photon_count || chosen[photon] == NOWHERE {
        return;
    }
    let reached = reached_by(photon);
    for (var row = reached.first.y; row < reached.end.y; row++) {
        for (var column = reached.first.x; column < reached.end.x; column++) {
            let at = cell_at(reached.windows, column, row);
            let end = atomicLoad(&words[at + 1u]);
            let first = end - atomicLoad(&words[at]);
            var place = first;
            for (var entry = first; entry < end; entry++) {
                place += select(0u, 1u, unsorted[entry - sketch.entries_at] < photon);
            }
            atomicStore(&words[place], photon);
        }
    }
}
