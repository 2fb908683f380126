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
    var path = fresh_path(photon.origin, photon.direction, photon.left_instance, photon.left_triangle, photon.key);
    path.class_so_far = DIRECT;
    path.throughput = photon.weight;
    path.passing = photon.number;
    paths[slot] = path;
    queues[slot] = slot;
}
