// Adds the light samples that nothing hides, and the known light that nothing near hides.

@compute @workgroup_size(WORKGROUP)
fn occluded(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= counters.shadow_count {
        return;
    }
    let place = queues[counters.shadows_at + id.x];
    let shadow = shadows[place];
    var ray: Ray;
    ray.origin = shadow.origin;
    ray.t_max = shadow.t_max;
    ray.direction = shadow.direction;
    ray.left_instance = shadow.left_instance;
    ray.left_triangle = shadow.left_triangle;
    if is_occluded(ray, shadow.light_instance, shadow.light_triangle) {
        return;
    }
    // Both of a path may be looked at in one go: they bring light of different classes, to different words.
    let slot = place % pass_header.capacity;
    add_radiance(slot, shadow.classes & 0xffu, shadow.diffuse);
    add_radiance(slot, shadow.classes >> 8u, shadow.glossy);
}
