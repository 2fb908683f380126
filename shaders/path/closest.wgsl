// What the rays of paths that go on meet.

@compute @workgroup_size(WORKGROUP)
fn closest(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= counters.ray_count {
        return;
    }
    let slot = slot_at(id.x);
    var ray: Ray;
    ray.origin = paths[slot].origin;
    ray.t_max = FLOAT_MAX;
    ray.direction = paths[slot].direction;
    ray.left_instance = paths[slot].left_instance;
    ray.left_triangle = paths[slot].left_triangle;
    hits[slot] = closest_hit(ray);
}
