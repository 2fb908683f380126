// Paths that begin with rays along which light is gathered: what they bring, and by which numbers they go.

/// What a ray has brought so far.
struct RaySample {
    radiance: vec3f,
    /// To the surface that it meets first; below 0: there is none.
    distance_m: f32,
    /// Of its sampler.
    index: u32,
    padding_0: u32,
    padding_1: u32,
    padding_2: u32,
}

@group(2) @binding(4) var<storage, read_write> samples: array<RaySample>;

fn sampler_of(slot: u32, path: Path) -> PixelSampler {
    return PixelSampler(path.key, samples[slot].index);
}

/// Takes note of the surface that is met first, `distance_m` away.
fn note_first(slot: u32, albedo: vec3f, n: vec3f, position: vec3f, distance_m: f32) {
    samples[slot].distance_m = distance_m;
}

/// Of rays nobody asks that.
fn note_shining(slot: u32) {}

/// Nor that.
fn note_beyond(slot: u32, albedo: vec3f, n: vec3f) {}

fn add_radiance(slot: u32, class_of_light: u32, radiance: vec3f) {
    if ((pass_header.brought >> class_of_light) & 1u) != 0u {
        samples[slot].radiance += radiance;
    }
}
