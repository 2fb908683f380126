// For paths that ask the light octree.

fn scattered_light(surface: Surface, wo: vec3f, is_drawn: bool, draw: vec3f) -> ScatteredLight {
    return light_of_cells(surface, wo, is_drawn, draw);
}
