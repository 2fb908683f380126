// Light with the variance that the first level goes by: that of few samples is hardly known and is joined with what lies around; of fewer
// it is how light differs there, if that is more. Twin of `KnownBetter`.

@compute @workgroup_size(WORKGROUP)
fn known_better(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) invocation: u32,
) {
    let pixel = pixel_of(group, groups, invocation);
    if pixel.x >= band.rows {
        return;
    }
    let is_believed = band.is_believed == 1u;
    let own = own_at(pixel.x, pixel.y);
    let rgb = light_at(pixel.x, pixel.y);
    var variance = variance_at(pixel.x, pixel.y);
    var sum = select(luminance_of(rgb), 0.0, is_believed);
    var sum_of_squares = sum * sum;
    var weights = 1.0;
    for (var other = 0u; other < 9u; other++) {
        let there = beside(other, pixel.x, pixel.y, 1u);
        if !there.is_there {
            continue;
        }
        let weight = weight_of(apart_from(own, there));
        variance += weight * variance_at(there.row, there.column);
        weights += weight;
        if !is_believed {
            let luminance = luminance_of(light_at(there.row, there.column));
            sum += weight * luminance;
            sum_of_squares += weight * luminance * luminance;
        }
    }
    let mean = sum / weights;
    make(pixel.x, pixel.y, rgb, max(variance / weights, sum_of_squares / weights - mean * mean));
}
