// Puts each photon into the cells that its window reaches into, as they come.

@compute @workgroup_size(WORKGROUP)
fn fill(
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
            let entry = atomicAdd(&words[cell_at(reached.windows, column, row) + 1u], 1u);
            unsorted[entry - sketch.entries_at] = photon;
        }
    }
}
