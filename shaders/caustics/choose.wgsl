// Gives each photon the narrowest window that holds enough others, and counts it in the cells which that reaches into.

/// Photons in a window around a pixel.
fn photons_within(pixel: vec2i, half_px: i32) -> u32 {
    let extent = extent_px();
    let middle = pixel + vec2i(sketch.margin);
    let first = max(middle - vec2i(half_px), vec2i(0));
    let end = min(middle + vec2i(half_px + 1), extent);
    var count = 0u;
    for (var row = first.y; row < end.y; row++) {
        count += atomicLoad(&rows[row_at(row) + u32(end.x)]) - atomicLoad(&rows[row_at(row) + u32(first.x)]);
    }
    return count;
}

@compute @workgroup_size(WORKGROUP)
fn choose(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) invocation: u32,
) {
    let photon = number_of(group, groups, invocation);
    if photon >= sketch.photon_count || chosen[photon] == NOWHERE {
        return;
    }
    var width = 0u;
    while width < sketch.width_count && photons_within(place_of(photon), sketch.windows[width].half_px) < ENOUGH {
        width++;
    }
    chosen[photon] = width;
    let reached = reached_by(photon);
    for (var row = reached.first.y; row < reached.end.y; row++) {
        for (var column = reached.first.x; column < reached.end.x; column++) {
            atomicAdd(&words[cell_at(reached.windows, column, row)], 1u);
        }
    }
}
