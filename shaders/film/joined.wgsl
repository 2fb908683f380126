// One level of the noise filter: pixels so many apart are joined. Twin of `Joined`.

/// One plane: what differences of light are multiplied by.
@group(0) @binding(4) var<storage, read> per_differences: array<f32>;

@compute @workgroup_size(WORKGROUP)
fn joined(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) invocation: u32,
) {
    let pixel = pixel_of(group, groups, invocation);
    if pixel.x >= band.rows {
        return;
    }
    let own = own_at(pixel.x, pixel.y);
    let rgb = light_at(pixel.x, pixel.y);
    let per_own = per_differences[place_of(pixel.x, pixel.y, 1u)];
    var sum = rgb * OWN_WEIGHT;
    var variance = variance_at(pixel.x, pixel.y) * OWN_WEIGHT * OWN_WEIGHT;
    var weights = OWN_WEIGHT;
    for (var other = 0u; other < 9u; other++) {
        let there = beside(other, pixel.x, pixel.y, band.step);
        if !there.is_there {
            continue;
        }
        let light_there = light_at(there.row, there.column);
        let per_there = per_differences[place_of(there.row, there.column, 1u)];
        let differs = luminance_of(abs(rgb - light_there)) * max(per_own, per_there);
        let weight = weight_of(apart_from(own, there) + differs) * there.weight;
        sum += weight * light_there;
        variance += weight * weight * variance_at(there.row, there.column);
        weights += weight;
    }
    make(pixel.x, pixel.y, sum / weights, variance / (weights * weights));
}
