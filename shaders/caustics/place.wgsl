// Where each photon of a sketch shows, and how many do in each pixel.

@compute @workgroup_size(WORKGROUP)
fn place(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) invocation: u32,
) {
    let photon = number_of(group, groups, invocation);
    if photon >= sketch.photon_count {
        return;
    }
    let pixel = sketch_pixel(photons[photon].position, sketch.margin);
    if !pixel.is_there {
        chosen[photon] = NOWHERE;
        return;
    }
    let at = sketch.places_at + SKETCH_PLACE_WORDS * photon;
    atomicStore(&words[at], bitcast<u32>(pixel.at.x));
    atomicStore(&words[at + 1u], bitcast<u32>(pixel.at.y));
    let in_margin = pixel.at + vec2i(sketch.margin);
    // Right of the pixel's left corner.
    atomicAdd(&rows[row_at(in_margin.y) + u32(in_margin.x) + 1u], 1u);
}
