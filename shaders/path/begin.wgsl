// Begins a path for every pixel of the slice: `cpu.rs`, `primary_ray` and `sample_pixel`.

@compute @workgroup_size(WORKGROUP)
fn begin(@builtin(global_invocation_id) id: vec3u) {
    let slot = id.x;
    if slot == 0u {
        begin_counting();
    }
    if slot >= pass_header.path_count {
        return;
    }
    let pixel = pass_header.first_pixel + slot;
    let key = mix64(pass_header.seed_key ^ vec2u(pass_header.sequence, pixel));
    let u = four(PixelSampler(key, pass_header.index), 0u);
    let x = f32(pixel % pass_header.width) + u.x;
    let y = f32(pixel / pass_header.width) + u.y;
    let across = (2.0 * x / f32(pass_header.width) - 1.0) * pass_header.half_width;
    let upwards = (1.0 - 2.0 * y / f32(pass_header.height)) * pass_header.half_height;
    let offset = pass_header.right * across + pass_header.up * upwards;
    var path = fresh_path(pass_header.origin, normalize(offset - pass_header.back), NO_INDEX, NO_INDEX, key);
    if pass_header.is_perspective == 0u {
        path.origin += offset;
        path.direction = -pass_header.back;
    }
    paths[slot] = path;
    samples[slot] = PixelSample(vec3f(0.0), 0.0, vec3f(0.0), 0.0, vec3f(0.0), 0.0, vec3f(0.0), 0.0, vec3f(0.0), 0u, vec3f(0.0), 0u, vec3f(0.0), 0u);
    queues[slot] = slot;
}
