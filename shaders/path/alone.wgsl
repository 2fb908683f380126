// For paths that ask nobody.

struct ScatteredLight {
    indirect: vec3f,
    caustic: vec3f,
    blur_m: f32,
}

fn scattered_light(surface: Surface, wo: vec3f) -> ScatteredLight {
    return ScatteredLight(vec3f(0.0), vec3f(0.0), 0.0);
}
