// Triangles drawn onto planes: for every pixel the surface that a ray from the plane's eye through its middle meets first.
// `path/gpu/lookouts.rs` says who looks, and compares with rays.

/// A plane at distance 1 before an eye.
struct Plane {
    /// The eye, in render space.
    origin: vec3f,
    half_width: f32,
    right: vec3f,
    half_height: f32,
    up: vec3f,
    /// What is nearer along the axis is not seen, m.
    nearest_m: f32,
    back: vec3f,
    /// The triangle that the eye lies on; NO_INDEX for none.
    left_instance: u32,
    left_triangle: u32,
    padding_0: u32,
    padding_1: u32,
    padding_2: u32,
}

@group(2) @binding(0) var<storage, read> planes: array<Plane>;
/// Of each draw, by the number of its only instance: the plane, and what is drawn onto it.
@group(2) @binding(1) var<storage, read> draws: array<vec2u>;

struct Corner {
    @builtin(position) position: vec4f,
    /// Of the triangle's second and third vertex.
    @location(0) weights: vec2f,
    /// Plane, instance, triangle.
    @location(1) @interpolate(flat) names: vec3u,
}

@vertex
fn corner(@builtin(vertex_index) vertex: u32, @builtin(instance_index) draw: u32) -> Corner {
    let names = draws[draw];
    let plane = planes[names.x];
    let triangle = triangles[instances[names.y].triangle_base + vertex / 3u];
    let which = vertex % 3u;
    var p = bitcast<vec3f>(triangle.a.xyz);
    if which == 1u {
        p = triangle.b.xyz;
    } else if which == 2u {
        p = triangle.c.xyz;
    }
    // Differences of what is large first.
    let from_eye = to_render(names.y, p) + (placements[names.y].centre_in_render - plane.origin);
    let across = dot(from_eye, plane.right) / plane.half_width;
    let upwards = dot(from_eye, plane.up) / plane.half_height;
    // Nearness in place of depth: floats tell far ones as well apart as near ones.
    let position = vec4f(across, upwards, plane.nearest_m, -dot(from_eye, plane.back));
    let number = triangle.a.w & ((1u << TRIANGLE_AXIS_SHIFT) - 1u);
    return Corner(position, vec2f(f32(which == 1u), f32(which == 2u)), vec3u(names, number));
}

@fragment
fn seen(at: Corner) -> @location(0) vec4u {
    let plane = planes[at.names.x];
    let instance = at.names.y;
    let triangle = at.names.z;
    if instance == plane.left_instance && triangle == plane.left_triangle {
        discard;
    }
    // What is interpolated may leave the triangle by rounding.
    let b1 = clamp(at.weights.x, 0.0, 1.0);
    let b2 = clamp(at.weights.y, 0.0, 1.0 - b1);
    if HAS_MASKS {
        if !is_present(instance, triangle, b1, b2) {
            discard;
        }
    }
    return vec4u(instance, triangle, bitcast<u32>(b1), bitcast<u32>(b2));
}
