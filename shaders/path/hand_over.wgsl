// Hands the last paths of a slice over: each scattering of a few takes a card as long as one of thousands, and a CPU next to nothing.

/// A path that goes on elsewhere, on its way to the next surface.
struct HandedPath {
    path: Path,
    /// Of its slice.
    slot: u32,
    padding_0: u32,
    padding_1: u32,
    padding_2: u32,
}

@group(3) @binding(0) var<storage, read_write> handed: array<HandedPath>;

/// All that are left, if there is room for them; else none.
@compute @workgroup_size(WORKGROUP)
fn hand_over(@builtin(global_invocation_id) id: vec3u) {
    if counters.ray_count > arrayLength(&handed) || id.x >= counters.ray_count {
        return;
    }
    let slot = slot_at(id.x);
    handed[id.x] = HandedPath(paths[slot], slot, 0u, 0u, 0u);
}
