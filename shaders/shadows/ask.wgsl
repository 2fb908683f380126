// Adds the light samples of which maps tell what arrives, and leaves the others to rays.

@compute @workgroup_size(WORKGROUP)
fn ask(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= counters.shadow_count {
        return;
    }
    let place = queues[counters.shadows_at + id.x];
    let shadow = shadows[place];
    let share = lit_share(shadow);
    // What hides it may be a pane.
    let is_behind = HAS_GLASS && shadow.by_panes != NO_INDEX && share < 1.0;
    if share == ASKS_FOR_RAY || is_behind {
        let left = atomicAdd(&counters.next_left_count, 1u);
        queues[LEFT_SHADOWS * pass_header.capacity + left] = place;
        return;
    }
    // As where rays are traced: those of one path bring light to different words.
    let slot = place % pass_header.capacity;
    add_radiance(slot, shadow.classes & 0xffu, shadow.diffuse * share);
    add_radiance(slot, shadow.classes >> 8u, shadow.glossy * share);
}
