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
    let drawn = drawn_corner(names.y, vertex, plane.origin);
    let across = dot(drawn.from_eye, plane.right) / plane.half_width;
    let upwards = dot(drawn.from_eye, plane.up) / plane.half_height;
    let ahead = -dot(drawn.from_eye, plane.back);
    var position = vec4f(across, upwards, 1.0 - ahead / plane.reach_m, 1.0);
    if plane.is_perspective != 0u {
        position = vec4f(across, upwards, plane.reach_m, ahead);
    }
    return Corner(position, drawn.weights, vec2u(names.y, drawn.triangle));
}

@fragment
fn kept(at: Corner) {
    if HAS_MASKS {
        let weights = weights_within(at.weights);
        if !is_present(at.names.x, at.names.y, weights.x, weights.y) {
            discard;
        }
    }
}
