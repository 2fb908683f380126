// Begins a path with every photon that is sent out: `transport/light/source.rs` says where.

struct SentPhoton {
    origin: vec3f,
    left_instance: u32,
    direction: vec3f,
    left_triangle: u32,
    weight: vec3f,
    /// Among those of its light.
    number: u32,
    /// Of its light's numbers.
    key: vec2u,
    padding_0: u32,
    padding_1: u32,
}

@group(3) @binding(0) var<storage, read> sent: array<SentPhoton>;

@compute @workgroup_size(WORKGROUP)
fn begin(@builtin(global_invocation_id) id: vec3u) {
    let slot = id.x;
    if slot == 0u {
        begin_counting();
    }
    if slot >= pass_header.path_count {
        return;
    }
    let photon = sent[slot];
    var path: Path;
    path.origin = photon.origin;
    path.direction = photon.direction;
    path.medium = 0u;
    path.class_so_far = DIRECT;
    path.throughput = photon.weight;
    path.bounce = 0u;
    path.last_pdf = NO_DENSITY;
    path.eta_squared = 1.0;
    path.left_instance = photon.left_instance;
    path.left_triangle = photon.left_triangle;
    path.key = photon.key;
    path.lost_m = 0.0;
    path.passing = photon.number;
    path.since_gathered = 0u;
    paths[slot] = path;
    queues[slot] = slot;
}
