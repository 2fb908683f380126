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
    let drawn = drawn_corner(names.y, vertex, plane.origin);
    let across = dot(drawn.from_eye, plane.right) / plane.half_width;
    let upwards = dot(drawn.from_eye, plane.up) / plane.half_height;
    // Nearness in place of depth: floats tell far ones as well apart as near ones.
    let position = vec4f(across, upwards, plane.nearest_m, -dot(drawn.from_eye, plane.back));
    return Corner(position, drawn.weights, vec3u(names, drawn.triangle));
}

@fragment
fn seen(at: Corner) -> @location(0) vec4u {
    let plane = planes[at.names.x];
    let instance = at.names.y;
    let triangle = at.names.z;
    if instance == plane.left_instance && triangle == plane.left_triangle {
        discard;
    }
    let weights = weights_within(at.weights);
    if HAS_MASKS {
        if !is_present(instance, triangle, weights.x, weights.y) {
            discard;
        }
    }
    return vec4u(instance, triangle, bitcast<u32>(weights.x), bitcast<u32>(weights.y));
}
