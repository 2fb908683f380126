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
    var path: Path;
    path.origin = ray.origin;
    path.direction = ray.direction;
    path.medium = 0u;
    path.class_so_far = EMITTED;
    path.throughput = vec3f(1.0);
    path.bounce = 0u;
    path.last_pdf = NO_DENSITY;
    path.eta_squared = 1.0;
    path.left_instance = ray.left_instance;
    path.left_triangle = ray.left_triangle;
    path.key = ray.key;
    path.lost_m = 0.0;
    path.passing = 0u;
    path.since_gathered = 0u;
    paths[slot] = path;
    samples[slot] = RaySample(vec3f(0.0), -1.0, ray.index, 0u, 0u, 0u);
    queues[slot] = slot;
}
