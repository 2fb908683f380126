// Radiance that a picture of one pass shows: what is seen, with what joining has changed of it where that is done.

@group(0) @binding(2) var<storage, read> brightest: u32;
/// Light after joining, plane by plane.
@group(0) @binding(3) var<storage, read> joined: array<f32>;
/// Three floats a pixel, as bits.
@group(0) @binding(4) var<storage, read_write> radiances: array<u32>;

@compute @workgroup_size(WORKGROUP)
fn add_up(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) invocation: u32,
) {
    let pixel = pixel_of(group, groups, invocation);
    if pixel >= pixel_count() {
        return;
    }
    let seen = first_seen(pixel);
    let exponent = scale_exponent(brightest);
    let stride = first_pass.stride;
    let place = pixel / first_pass.width * LIGHT_PLANES * stride + MARGIN + pixel % first_pass.width;
    let after = vec3f(joined[place], joined[place + stride], joined[place + 2u * stride]);
    let scaled = (after - even_light(seen, exponent)) * divisor_of(seen);
    // Before it is multiplied, as products may not leave the range; and no more than a sum of two may be.
    let bound = 0.25 * FLOAT_MAX;
    let most = vec3f(bound * power_of_two(min(exponent, 0)));
    let change = clamp(scaled, -most, most) * power_of_two(-exponent);
    let shown = clamp(clamp(seen.radiance, vec3f(0.0), vec3f(bound)) + change, vec3f(0.0), vec3f(FLOAT_MAX));
    radiances[3u * pixel] = bitcast<u32>(shown.x);
    radiances[3u * pixel + 1u] = bitcast<u32>(shown.y);
    radiances[3u * pixel + 2u] = bitcast<u32>(shown.z);
}
