// Gives each cell room for its entries. Which room is a matter of chance, and nothing that a look-up could see.

@compute @workgroup_size(WORKGROUP)
fn allot(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) invocation: u32,
) {
    let cell = number_of(group, groups, invocation);
    if cell >= sketch.cell_count {
        return;
    }
    let at = sketch.windows[0].cells_at + SKETCH_CELL_WORDS * cell;
    let count = atomicLoad(&words[at]);
    if count > 0u {
        // Where the next entry goes, until it has all of them.
        atomicStore(&words[at + 1u], sketch.entries_at + atomicAdd(&words[0], count));
    }
}
