// Between asking maps and tracing the shadow rays that those leave: these learn how many they are.

@compute @workgroup_size(1)
fn turn_shadows() {
    let left = atomicLoad(&counters.next_left_count);
    atomicStore(&counters.next_left_count, 0u);
    counters.shadow_rays -= counters.shadow_count - left;
    counters.shadow_count = left;
    counters.shadows_at = LEFT_SHADOWS * pass_header.capacity;
    dispatch.shadow_rays_x = workgroups_for(left);
}
