// Between two scatterings: the filled queue becomes the one that is read, and the steps to come learn how much there is to do.

@compute @workgroup_size(1)
fn turn() {
    counters.rays += counters.ray_count;
    counters.ray_count = atomicLoad(&counters.next_ray_count);
    counters.shadow_count = atomicLoad(&counters.next_shadow_count);
    counters.shadow_rays += counters.shadow_count;
    counters.shadows_at = SHADOWS * pass_header.capacity;
    atomicStore(&counters.next_ray_count, 0u);
    atomicStore(&counters.next_shadow_count, 0u);
    counters.parity = 1u - counters.parity;
    dispatch = Dispatch(workgroups_for(counters.ray_count), 1u, 1u, workgroups_for(counters.shadow_count), 1u, 1u, 0u, 0u);
}
