// Triangles drawn onto what lights see: in each texel the nearness of what a ray through its middle meets first.

@group(2) @binding(0) var<storage, read> shadow_planes: array<ShadowPlane>;
/// Of each draw, by the number of its only instance: the plane, and what is drawn onto it.
@group(2) @binding(1) var<storage, read> draws: array<vec2u>;

struct Corner {
    @builtin(position) position: vec4f,
    /// Of the triangle's second and third vertex.
    @location(0) weights: vec2f,
    /// Instance, triangle.
    @location(1) @interpolate(flat) names: vec2u,
}

@vertex
fn corner(@builtin(vertex_index) vertex: u32, @builtin(instance_index) draw: u32) -> Corner {
    let names = draws[draw];
    let plane = shadow_planes[names.x];
    let triangle = triangles[instances[names.y].triangle_base + vertex / 3u];
    let which = vertex % 3u;
    var p = bitcast<vec3f>(triangle.a.xyz);
    if which == 1u {
        p = triangle.b.xyz;
    } else if which == 2u {
        p = triangle.c.xyz;
    }
    // Differences of what is large first.
    let from_light = to_render(names.y, p) + (placements[names.y].centre_in_render - plane.origin);
    let across = dot(from_light, plane.right) / plane.half_width;
    let upwards = dot(from_light, plane.up) / plane.half_height;
    let ahead = -dot(from_light, plane.back);
    var position = vec4f(across, upwards, 1.0 - ahead / plane.reach_m, 1.0);
    if plane.is_perspective != 0u {
        position = vec4f(across, upwards, plane.reach_m, ahead);
    }
    let number = triangle.a.w & ((1u << TRIANGLE_AXIS_SHIFT) - 1u);
    return Corner(position, vec2f(f32(which == 1u), f32(which == 2u)), vec2u(names.y, number));
}

@fragment
fn kept(at: Corner) {
    if HAS_MASKS {
        // What is interpolated may leave the triangle by rounding.
        let b1 = clamp(at.weights.x, 0.0, 1.0);
        let b2 = clamp(at.weights.y, 0.0, 1.0 - b1);
        if !is_present(at.names.x, at.names.y, b1, b2) {
            discard;
        }
    }
}
