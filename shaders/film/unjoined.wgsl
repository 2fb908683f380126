// Pixels of a first pass before they are joined with those around, plane by plane as `film/denoise/planes.rs` has them; nothing in margins,
// which nobody reads here.

@group(0) @binding(2) var<storage, read> brightest: u32;
@group(0) @binding(3) var<storage, read_write> surfaces: array<f32>;
@group(0) @binding(4) var<storage, read_write> light: array<f32>;

/// How much the depth changes to the neighbour to which it changes less, at edges that on the side that goes on.
fn slope(depth_m: f32, pixel: u32, place: u32, count: u32, step: u32) -> f32 {
    let has_before = place > 0u;
    let has_after = place + 1u < count;
    var least = FLOAT_MAX;
    if has_before {
        least = abs(first_seen(pixel - step).depth_m - depth_m);
    }
    if has_after {
        least = min(least, abs(first_seen(pixel + step).depth_m - depth_m));
    }
    return select(0.0, least, has_before || has_after);
}

@compute @workgroup_size(WORKGROUP)
fn lay_out(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) invocation: u32,
) {
    let pixel = pixel_of(group, groups, invocation);
    if pixel >= pixel_count() {
        return;
    }
    let column = pixel % first_pass.width;
    let row = pixel / first_pass.width;
    let seen = first_seen(pixel);
    let stride = first_pass.stride;
    var place = row * SURFACE_PLANES * stride + MARGIN + column;
    surfaces[place + NORMAL_PLANE * stride] = seen.normal.x;
    surfaces[place + (NORMAL_PLANE + 1u) * stride] = seen.normal.y;
    surfaces[place + (NORMAL_PLANE + 2u) * stride] = seen.normal.z;
    surfaces[place + ALBEDO_PLANE * stride] = seen.albedo.x;
    surfaces[place + (ALBEDO_PLANE + 1u) * stride] = seen.albedo.y;
    surfaces[place + (ALBEDO_PLANE + 2u) * stride] = seen.albedo.z;
    surfaces[place + DEPTH_PLANE * stride] = seen.depth_m;
    // What is not hit has no depth.
    let apart_m = max(DEPTH_APART * seen.depth_m, 1.0 / WITHOUT_BOUND);
    surfaces[place + PER_DEPTH_PLANE * stride] = min(1.0 / apart_m, WITHOUT_BOUND);
    surfaces[place + SLOPE_PLANE * stride] = slope(seen.depth_m, pixel, column, first_pass.width, 1u);
    surfaces[place + (SLOPE_PLANE + 1u) * stride] =
        slope(seen.depth_m, pixel, row, first_pass.rows, first_pass.width);
    place = row * LIGHT_PLANES * stride + MARGIN + column;
    let even = even_light(seen, scale_exponent(brightest));
    light[place] = even.x;
    light[place + stride] = even.y;
    light[place + 2u * stride] = even.z;
    light[place + 3u * stride] = 0.0;
}
