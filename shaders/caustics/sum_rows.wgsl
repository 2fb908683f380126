// Adds photons up along each row: `Counts` in `screen/mod.rs`, but that rows are not added to each other.

@compute @workgroup_size(WORKGROUP)
fn sum_rows(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) invocation: u32,
) {
    let row = number_of(group, groups, invocation);
    let extent = extent_px();
    if row >= u32(extent.y) {
        return;
    }
    var sum = 0u;
    for (var column = 1; column <= extent.x; column++) {
        let at = row_at(i32(row)) + u32(column);
        sum += atomicLoad(&rows[at]);
        atomicStore(&rows[at], sum);
    }
}
