// What differences of light are multiplied by at a level: one over the deviations at which they count, by the variance around. Twin of
// `PerDifference`; one plane.

@compute @workgroup_size(WORKGROUP)
fn per_difference(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) invocation: u32,
) {
    let pixel = pixel_of(group, groups, invocation);
    if pixel.x >= band.rows {
        return;
    }
    var variance = variance_at(pixel.x, pixel.y) * OWN_WEIGHT;
    for (var other = 0u; other < 9u; other++) {
        let there = beside(other, pixel.x, pixel.y, 1u);
        if there.is_there {
            variance += variance_at(there.row, there.column) * there.weight;
        }
    }
    made[place_of(pixel.x, pixel.y, 1u)] = 1.0 / max(DEVIATIONS * sqrt(variance), 1.0 / WITHOUT_BOUND);
}
