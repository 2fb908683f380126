// The brightest light that noise is taken off, as bits, which are ordered as floats are that are not negative.

@group(0) @binding(2) var<storage, read_write> brightest: atomic<u32>;

var<workgroup> of_group: atomic<u32>;

@compute @workgroup_size(WORKGROUP)
fn find_brightest(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) invocation: u32,
) {
    let pixel = pixel_of(group, groups, invocation);
    if pixel < pixel_count() {
        let light = first_seen(pixel).light;
        atomicMax(&of_group, bitcast<u32>(max(light.x, max(light.y, light.z))));
    }
    workgroupBarrier();
    if invocation == 0u {
        atomicMax(&brightest, atomicLoad(&of_group));
    }
}
