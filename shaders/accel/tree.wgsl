// Stand-in until the walk is here: structs only.

struct Ray {
    origin: vec3f,
    t_max: f32,
    direction: vec3f,
    left_instance: u32,
    left_triangle: u32,
}

struct Hit {
    t: f32,
    instance: u32,
    triangle: u32,
    b1: f32,
    b2: f32,
}

fn closest_hit(ray: Ray) -> Hit {
    return Hit(ray.t_max, 0xffffffffu, 0xffffffffu, 0.0, 0.0);
}

fn is_occluded(ray: Ray, light_instance: u32, light_triangle: u32) -> bool {
    return false;
}
