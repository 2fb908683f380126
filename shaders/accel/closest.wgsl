// The nearest surface along every ray of a buffer: the walk by itself, as tests and measurements want it.

@group(1) @binding(0) var<storage, read> rays: array<Ray>;
@group(1) @binding(1) var<storage, read_write> hits: array<Hit>;

@compute @workgroup_size(64)
fn closest(
    @builtin(workgroup_id) workgroup: vec3u,
    @builtin(num_workgroups) workgroup_count: vec3u,
    @builtin(local_invocation_index) invocation: u32,
) {
    let index = (workgroup.y * workgroup_count.x + workgroup.x) * 64u + invocation;
    if index < arrayLength(&rays) {
        hits[index] = closest_hit(rays[index]);
    }
}
