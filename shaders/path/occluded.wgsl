// Adds the light samples that nothing hides, or panes alone, and the known light that nothing near hides.

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
    let slot = place % pass_header.capacity;
    if !is_occluded(ray, shadow.light_instance, shadow.light_triangle) {
        bring(slot, shadow, vec3f(1.0));
    } else if HAS_GLASS && shadow.by_panes != NO_INDEX {
        let passage = through_panes(ray);
        atomicAdd(&counters.pane_rays, passage.rays);
        let beyond = shadows[shadow.by_panes];
        if passage.exists && passage.boundaries <= beyond.light {
            bring(slot, beyond, passage.share);
        }
    }
}

/// Both of a path may be looked at in one go: they bring light of different classes, to different words.
fn bring(slot: u32, shadow: Shadow, share: vec3f) {
    add_radiance(slot, shadow.classes & 0xffu, shadow.diffuse * share);
    add_radiance(slot, shadow.classes >> 8u, shadow.glossy * share);
}
