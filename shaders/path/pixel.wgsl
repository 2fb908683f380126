// Paths of pixels: what they bring, and by which numbers they go.

/// What a pixel's path has brought; `film/pixel.rs`, `PixelSample`.
struct PixelSample {
    emitted: vec3f,
    depth_m: f32,
    direct: vec3f,
    albedo_red: f32,
    caustic: vec3f,
    albedo_green: f32,
    indirect: vec3f,
    albedo_blue: f32,
    specular: vec3f,
    is_shining: u32,
    normal: vec3f,
    /// Signed bytes of 127; the last is nothing where nothing is noted.
    beyond_normal: u32,
    beyond_albedo: vec3f,
    padding_0: u32,
}

@group(2) @binding(4) var<storage, read_write> samples: array<PixelSample>;

fn sampler_of(slot: u32, path: Path) -> PixelSampler {
    return PixelSampler(path.key, pass_header.index);
}

/// Takes note that what is seen straight or in mirrors shines by itself, or is beyond the scene.
fn note_shining(slot: u32) {
    samples[slot].is_shining = 1u;
}

/// Takes note of the surface that is seen first, `distance_m` away.
fn note_first(slot: u32, albedo: vec3f, n: vec3f, position: vec3f, distance_m: f32) {
    samples[slot].albedo_red = albedo.x;
    samples[slot].albedo_green = albedo.y;
    samples[slot].albedo_blue = albedo.z;
    samples[slot].normal = n;
    samples[slot].depth_m = max(dot(pass_header.origin - position, pass_header.back), 0.0);
}

/// Takes note of what is seen beyond mirrors and clear glass.
fn note_beyond(slot: u32, albedo: vec3f, n: vec3f) {
    samples[slot].beyond_albedo = albedo;
    samples[slot].beyond_normal = pack4x8snorm(vec4f(n, 1.0));
}

fn add_radiance(slot: u32, class_of_light: u32, radiance: vec3f) {
    switch class_of_light {
        case EMITTED: {
            samples[slot].emitted += radiance;
        }
        case DIRECT: {
            samples[slot].direct += radiance;
        }
        case CAUSTIC: {
            samples[slot].caustic += radiance;
        }
        case BY_SPECULAR: {
            samples[slot].specular += radiance;
        }
        default: {
            samples[slot].indirect += radiance;
        }
    }
}
