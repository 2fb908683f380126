// For paths that ask nobody.

fn scattered_light(surface: Surface, wo: vec3f, is_drawn: bool, draw: vec3f) -> ScatteredLight {
    return nothing_known();
}
