// A path that begins, before whoever begins it says more.

fn fresh_path(origin: vec3f, direction: vec3f, left_instance: u32, left_triangle: u32, key: vec2u) -> Path {
    var path: Path;
    path.origin = origin;
    path.direction = direction;
    path.medium = 0u;
    path.class_so_far = EMITTED;
    path.throughput = vec3f(1.0);
    path.bounce = 0u;
    path.last_pdf = NO_DENSITY;
    path.eta_squared = 1.0;
    path.left_instance = left_instance;
    path.left_triangle = left_triangle;
    path.key = key;
    path.lost_m = 0.0;
    path.passing = 0u;
    path.since_gathered = 0u;
    return path;
}
