// Begins a path with every ray of the slice: `path/mod.rs`, `ArrivingLight::radiance`.

/// A ray that light is gathered along.
struct GatherRay {
    origin: vec3f,
    left_instance: u32,
    direction: vec3f,
    left_triangle: u32,
    /// Of its sampler.
    key: vec2u,
    index: u32,
    padding_0: u32,
}

@group(3) @binding(0) var<storage, read> gather_rays: array<GatherRay>;

@compute @workgroup_size(WORKGROUP)
fn begin(@builtin(global_invocation_id) id: vec3u) {
    let slot = id.x;
    if slot == 0u {
        begin_counting();
    }
    if slot >= pass_header.path_count {
        return;
    }
    let ray = gather_rays[slot];
    paths[slot] = fresh_path(ray.origin, ray.direction, ray.left_instance, ray.left_triangle, ray.key);
    samples[slot] = RaySample(vec3f(0.0), -1.0, ray.index, 0u, 0u, 0u);
    queues[slot] = slot;
}
