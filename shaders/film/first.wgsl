// What a film of one pass shows, by the samples of that pass as they lie on a card: `film/pixel.rs`, and `Seen` of `film/denoise.rs`, whose
// numbers are prepended. Of one sample no variance is known.

struct FirstPass {
    /// Pixels of a row.
    width: u32,
    rows: u32,
    /// Numbers from one plane of a row to the next.
    stride: u32,
    /// Bit c: light of paths of class c is shown.
    shown: u32,
}

@group(0) @binding(0) var<uniform> first_pass: FirstPass;
/// As `PixelSample` of `path/pixel.wgsl`, as bits: floats may be assumed to be neither infinite nor NaN.
@group(0) @binding(1) var<storage, read> samples: array<u32>;

/// Words of a sample, of light of a class in it, and where the rest stands.
const SAMPLE_WORDS: u32 = 28u;
const CLASS_WORDS: u32 = 4u;
const DEPTH_WORD: u32 = 3u;
/// Of red; of the others as much further on as light of the next class.
const ALBEDO_WORD: u32 = 7u;
const NORMAL_WORD: u32 = 20u;
const SHINING_WORD: u32 = 19u;
/// What is seen beyond mirrors and clear glass: bytes of its normal, the last of which says whether it is noted, before its albedo.
const BEYOND_WORD: u32 = 24u;
const BEYOND_NORMAL_WORD: u32 = 23u;
const IS_NOTED: u32 = 0xff000000u;

const EMITTED: u32 = 0u;
const BY_SPECULAR: u32 = 4u;
const CLASS_COUNT: u32 = 5u;

const INFINITE_BITS: u32 = 0x7f800000u;
const SIGN_BIT: u32 = 0x80000000u;

/// What is seen in a pixel.
struct FirstSeen {
    /// Of all classes that are shown, W/(m² sr).
    radiance: vec3f,
    /// Of those that noise is taken off.
    light: vec3f,
    albedo: vec3f,
    normal: vec3f,
    depth_m: f32,
}

fn is_finite(bits: u32) -> bool {
    return (bits & INFINITE_BITS) != INFINITE_BITS;
}

fn is_at_least_zero(bits: u32) -> bool {
    return is_finite(bits) && ((bits & SIGN_BIT) == 0u || bits == SIGN_BIT);
}

fn is_shown(class_of_light: u32) -> bool {
    return ((first_pass.shown >> class_of_light) & 1u) != 0u;
}

fn light_of(at: u32, class_of_light: u32) -> vec3f {
    let word = at + CLASS_WORDS * class_of_light;
    return vec3f(bitcast<f32>(samples[word]), bitcast<f32>(samples[word + 1u]), bitcast<f32>(samples[word + 2u]));
}

/// `PixelSample::is_sound`.
fn is_sound(at: u32) -> bool {
    for (var class_of_light = 0u; class_of_light < CLASS_COUNT; class_of_light++) {
        for (var channel = 0u; channel < 3u; channel++) {
            let bits = samples[at + CLASS_WORDS * class_of_light + channel];
            let is_taken = is_at_least_zero(bits) && bitcast<f32>(bits) <= FLOAT_MAX / f32(CLASS_COUNT);
            if is_shown(class_of_light) && !is_taken {
                return false;
            }
        }
    }
    for (var channel = 0u; channel < 3u; channel++) {
        if !is_at_least_zero(samples[at + ALBEDO_WORD + CLASS_WORDS * channel]) || !is_finite(samples[at + NORMAL_WORD + channel]) {
            return false;
        }
    }
    for (var channel = 0u; channel < 3u; channel++) {
        if notes_beyond(at) && !is_at_least_zero(samples[at + BEYOND_WORD + channel]) {
            return false;
        }
    }
    return is_at_least_zero(samples[at + DEPTH_WORD]);
}

fn notes_beyond(at: u32) -> bool {
    return (samples[at + BEYOND_NORMAL_WORD] & IS_NOTED) != 0u;
}

fn nothing_seen() -> FirstSeen {
    return FirstSeen(vec3f(0.0), vec3f(0.0), vec3f(0.0), vec3f(0.0), 0.0);
}

/// `Vec3::normalize_or_zero`.
fn unit_or_zero(v: vec3f) -> vec3f {
    let squared = dot(v, v);
    if squared > 0.0 && squared <= FLOAT_MAX {
        return v * (1.0 / sqrt(squared));
    }
    return vec3f(0.0);
}

fn first_seen(pixel: u32) -> FirstSeen {
    let at = SAMPLE_WORDS * pixel;
    if !is_sound(at) {
        return nothing_seen();
    }
    var seen = nothing_seen();
    let is_shining = samples[at + SHINING_WORD] != 0u;
    for (var class_of_light = 0u; class_of_light < CLASS_COUNT; class_of_light++) {
        if is_shown(class_of_light) {
            let light = light_of(at, class_of_light);
            seen.radiance += light;
            // What is seen of emitters straight or in mirrors is left alone.
            let is_seen = class_of_light == EMITTED || class_of_light == BY_SPECULAR;
            if !is_seen || !is_shining {
                seen.light += light;
            }
        }
    }
    let albedo = vec3f(
        bitcast<f32>(samples[at + ALBEDO_WORD]),
        bitcast<f32>(samples[at + ALBEDO_WORD + CLASS_WORDS]),
        bitcast<f32>(samples[at + ALBEDO_WORD + 2u * CLASS_WORDS]),
    );
    seen.albedo = min(albedo, vec3f(SURFACE_MAX));
    seen.depth_m = min(bitcast<f32>(samples[at + DEPTH_WORD]), SURFACE_MAX);
    if seen.depth_m > 0.0 {
        seen.normal = unit_or_zero(vec3f(
            bitcast<f32>(samples[at + NORMAL_WORD]),
            bitcast<f32>(samples[at + NORMAL_WORD + 1u]),
            bitcast<f32>(samples[at + NORMAL_WORD + 2u]),
        ));
    }
    if notes_beyond(at) {
        let of_beyond = vec3f(
            bitcast<f32>(samples[at + BEYOND_WORD]),
            bitcast<f32>(samples[at + BEYOND_WORD + 1u]),
            bitcast<f32>(samples[at + BEYOND_WORD + 2u]),
        );
        seen.albedo = min(of_beyond, vec3f(SURFACE_MAX));
        seen.normal = unit_or_zero(unpack4x8snorm(samples[at + BEYOND_NORMAL_WORD]).xyz);
    }
    return seen;
}

/// What light is divided by.
fn divisor_of(seen: FirstSeen) -> vec3f {
    return seen.albedo + ALBEDO_LEAST;
}

/// The exponent of the power of two that brings light near one, from the bits of the brightest.
fn scale_exponent(brightest: u32) -> i32 {
    let normal = max(brightest, 0x00800000u);
    let exponent = i32(normal >> 23u) - 127;
    let is_between = (normal & 0x007fffffu) != 0u;
    // Both the power and one over it are to be floats.
    return clamp(-(exponent + select(0, 1, is_between)), -126, 126);
}

fn power_of_two(exponent: i32) -> f32 {
    return bitcast<f32>(u32(exponent + 127) << 23u);
}

/// Light over albedo, scaled.
fn even_light(seen: FirstSeen, exponent: i32) -> vec3f {
    return (seen.light * power_of_two(exponent)) / divisor_of(seen);
}

/// Number of an invocation; beyond the last pixel for those that are too many.
fn pixel_of(group: vec3u, groups: vec3u, invocation: u32) -> u32 {
    return (group.y * groups.x + group.x) * WORKGROUP + invocation;
}

fn pixel_count() -> u32 {
    return first_pass.width * first_pass.rows;
}
