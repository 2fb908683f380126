// Triangles of the scene as they are drawn onto planes, by the numbers of a draw's vertices.

/// A corner of a triangle that is drawn.
struct DrawnCorner {
    /// From where it is looked at.
    from_eye: vec3f,
    /// Of the triangle's second and third vertex.
    weights: vec2f,
    /// The triangle's number in its mesh.
    triangle: u32,
}

fn drawn_corner(instance: u32, vertex: u32, eye: vec3f) -> DrawnCorner {
    let triangle = triangles[instances[instance].triangle_base + vertex / 3u];
    let which = vertex % 3u;
    var p = bitcast<vec3f>(triangle.a.xyz);
    if which == 1u {
        p = triangle.b.xyz;
    } else if which == 2u {
        p = triangle.c.xyz;
    }
    // Differences of what is large first.
    let from_eye = to_render(instance, p) + (placements[instance].centre_in_render - eye);
    let number = triangle.a.w & ((1u << TRIANGLE_AXIS_SHIFT) - 1u);
    return DrawnCorner(from_eye, vec2f(f32(which == 1u), f32(which == 2u)), number);
}

/// Weights of the second and third vertex where a pixel sees a triangle: what is interpolated may leave it by rounding.
fn weights_within(weights: vec2f) -> vec2f {
    let b1 = clamp(weights.x, 0.0, 1.0);
    return vec2f(b1, clamp(weights.y, 0.0, 1.0 - b1));
}
