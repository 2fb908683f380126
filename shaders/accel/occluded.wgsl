// Whether anything lies on every ray of a buffer: 1 or 0.

struct ShadowRay {
    ray: Ray,
    // The triangle of the light that the ray leads to, which does not stand in its own way; 0xffffffff for none.
    light_instance: u32,
    light_triangle: u32,
    padding_0: u32,
    padding_1: u32,
}

@group(1) @binding(0) var<storage, read> rays: array<ShadowRay>;
@group(1) @binding(1) var<storage, read_write> occluded_flags: array<u32>;

@compute @workgroup_size(64)
fn occluded(
    @builtin(workgroup_id) workgroup: vec3u,
    @builtin(num_workgroups) workgroup_count: vec3u,
    @builtin(local_invocation_index) invocation: u32,
) {
    let index = (workgroup.y * workgroup_count.x + workgroup.x) * 64u + invocation;
    if index < arrayLength(&rays) {
        let shadow = rays[index];
        let is_hidden = is_occluded(shadow.ray, shadow.light_instance, shadow.light_triangle);
        occluded_flags[index] = select(0u, 1u, is_hidden);
    }
}
