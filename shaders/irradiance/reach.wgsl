// The spheres of all records' reach side by side: tiles look through all of them, and they are a tenth of the bytes.

@group(0) @binding(0) var<storage, read> records: array<Record>;
@group(0) @binding(1) var<storage, read> record_words: array<u32>;
/// Middle and radius.
@group(0) @binding(2) var<storage, read_write> spheres: array<vec4f>;

@compute @workgroup_size(WORKGROUP)
fn reach(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) invocation: u32,
) {
    let record = (group.y * groups.x + group.x) * WORKGROUP + invocation;
    if record >= arrayLength(&spheres) {
        return;
    }
    spheres[record] = vec4f(records[record].position, records[record].reach_m);
}
