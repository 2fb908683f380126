// Puts the photons of each cell into their order, so that sums over them have the same bits whatever came first. Each entry has an
// invocation of its own, which goes over one cell: its loops do not grow with how many cells a photon's window reaches into.

@compute @workgroup_size(WORKGROUP)
fn order(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) invocation: u32,
) {
    let number = number_of(group, groups, invocation);
    if number >= atomicLoad(&words[0]) {
        return;
    }
    let entry = sketch.entries_at + number;
    let photon = unsorted[number];
    let reached = reached_by(photon);
    for (var row = reached.first.y; row < reached.end.y; row++) {
        for (var column = reached.first.x; column < reached.end.x; column++) {
            let at = cell_at(reached.windows, column, row);
            let end = atomicLoad(&words[at + 1u]);
            let first = end - atomicLoad(&words[at]);
            // The photon's entries in other cells are others' to place.
            if entry < first || entry >= end {
                continue;
            }
            var place = first;
            for (var other = first; other < end; other++) {
                place += select(0u, 1u, unsorted[other - sketch.entries_at] < photon);
            }
            atomicStore(&words[place], photon);
        }
    }
}
