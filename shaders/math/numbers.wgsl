// Frames, warps, and the Owen-scrambled Sobol points of the CPU: the same key and index give the same numbers.
// The room `math` in WGSL; where a formula comes from stands there.

const PI: f32 = 3.14159265358979;
const TAU: f32 = 6.28318530717959;
const INVERSE_PI: f32 = 0.318309886183791;
const ONE_LESS: f32 = 0.99999988;
const LEAST_NORMAL: f32 = 1.17549435e-38;

/// |magnitude| with the sign of `sign`; zero counts as its own sign says.
fn copysign(magnitude: f32, sign: f32) -> f32 {
    return bitcast<f32>((bitcast<u32>(magnitude) & 0x7fffffffu) | (bitcast<u32>(sign) & 0x80000000u));
}

fn length_squared(v: vec3f) -> f32 {
    return dot(v, v);
}

/// The unit vector along `v`, or `other` where it has no direction that a float can tell. Scaled first: squares of short and
/// long vectors leave the range.
fn normalize_or(v: vec3f, other: vec3f) -> vec3f {
    let largest = max(abs(v.x), max(abs(v.y), abs(v.z)));
    if !(largest > LEAST_NORMAL) {
        return other;
    }
    return normalize(v / largest);
}

fn max_component(v: vec3f) -> f32 {
    return max(v.x, max(v.y, v.z));
}

/// Rec.709.
fn luminance(rgb: vec3f) -> f32 {
    return 0.2126 * rgb.x + 0.7152 * rgb.y + 0.0722 * rgb.z;
}

fn is_black(rgb: vec3f) -> bool {
    return all(rgb == vec3f(0.0));
}

struct Frame {
    t: vec3f,
    b: vec3f,
    n: vec3f,
}

/// Around unit `n` [Duff2017].
fn frame_around(n: vec3f) -> Frame {
    let sign = copysign(1.0, n.z);
    let a = -1.0 / (sign + n.z);
    let b = n.x * n.y * a;
    return Frame(
        vec3f(1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x),
        vec3f(b, sign + n.y * n.y * a, -n.y),
        n,
    );
}

fn frame_to_world(frame: Frame, v: vec3f) -> vec3f {
    return frame.t * v.x + frame.b * v.y + frame.n * v.z;
}

fn frame_to_local(frame: Frame, v: vec3f) -> vec3f {
    return vec3f(dot(v, frame.t), dot(v, frame.b), dot(v, frame.n));
}

/// [Shirley1997]
fn disc(u: vec2f) -> vec2f {
    let offset = 2.0 * u - 1.0;
    if offset.x == 0.0 && offset.y == 0.0 {
        return vec2f(0.0);
    }
    var radius = offset.y;
    var angle = PI * 0.5;
    if abs(offset.x) > abs(offset.y) {
        radius = offset.x;
        angle = PI * 0.25 * (offset.y / offset.x);
    } else {
        angle = PI * 0.5 - PI * 0.25 * (offset.x / offset.y);
    }
    return vec2f(cos(angle), sin(angle)) * radius;
}

fn cosine_hemisphere(u: vec2f) -> vec3f {
    let d = disc(u);
    return vec3f(d, sqrt(max(1.0 - dot(d, d), 0.0)));
}

fn cosine_hemisphere_pdf(cos_theta: f32) -> f32 {
    return max(cos_theta, 0.0) * INVERSE_PI;
}

/// [Heitz2019]
fn triangle_weights(u: vec2f) -> vec2f {
    if u.x < u.y {
        let b0 = u.x * 0.5;
        return vec2f(u.y - b0, 1.0 - b0 - (u.y - b0));
    }
    let b1 = u.y * 0.5;
    return vec2f(b1, 1.0 - (u.x - b1) - b1);
}

// 64-bit numbers: x the low half, y the high one.

fn add64(a: vec2u, b: vec2u) -> vec2u {
    let low = a.x + b.x;
    return vec2u(low, a.y + b.y + select(0u, 1u, low < a.x));
}

/// a · b, both of 32 bits, whole.
fn mul32(a: u32, b: u32) -> vec2u {
    let a_low = a & 0xffffu;
    let a_high = a >> 16u;
    let b_low = b & 0xffffu;
    let b_high = b >> 16u;
    let low = a_low * b_low;
    let middle = a_high * b_low + (low >> 16u);
    let middle_too = a_low * b_high + (middle & 0xffffu);
    return vec2u((middle_too << 16u) | (low & 0xffffu), a_high * b_high + (middle >> 16u) + (middle_too >> 16u));
}

fn mul64(a: vec2u, b: vec2u) -> vec2u {
    let low = mul32(a.x, b.x);
    return vec2u(low.x, low.y + a.x * b.y + a.y * b.x);
}

fn xor_shifted(a: vec2u, by: u32) -> vec2u {
    return a ^ vec2u((a.x >> by) | (a.y << (32u - by)), a.y >> by);
}

/// [Steele2014]
fn mix64(key: vec2u) -> vec2u {
    var mixed = mul64(xor_shifted(key, 30u), vec2u(0x1ce4e5b9u, 0xbf58476du));
    mixed = mul64(xor_shifted(mixed, 27u), vec2u(0x133111ebu, 0x94d049bbu));
    return xor_shifted(mixed, 31u);
}

const GOLDEN: vec2u = vec2u(0x7f4a7c15u, 0x9e3779b9u);

fn scramble_mirrored(number: u32, seed: u32) -> u32 {
    var x = number;
    x ^= x * 0x3d20adeau;
    x += seed;
    x *= (seed >> 16u) | 1u;
    x ^= x * 0x05526c56u;
    return x ^ (x * 0x53a22864u);
}

/// Random numbers of one sample of one pixel.
struct PixelSampler {
    key: vec2u,
    index: u32,
}

/// Four numbers in [0, 1) of dimension set `dimensions`: `math/sobol.rs`, `PixelSampler::four`.
fn four(sampler: PixelSampler, dimensions: u32) -> vec4f {
    let key = add64(sampler.key, mul64(vec2u(dimensions, 0u), GOLDEN));
    let seeds = mix64(key);
    let mirrored = scramble_mirrored(reverseBits(sampler.index), seeds.x);
    let digits = sobol_sum(0u, mirrored & 0xffu) ^ sobol_sum(1u, (mirrored >> 8u) & 0xffu)
        ^ sobol_sum(2u, (mirrored >> 16u) & 0xffu) ^ sobol_sum(3u, mirrored >> 24u);
    let low = mix64(seeds ^ vec2u(0x7f4a7c15u, 0x9e3779b9u));
    let high = mix64(seeds ^ vec2u(0xd192ed03u, 0xd1b54a32u));
    return vec4f(
        unit(scramble_mirrored(digits.x, low.x)),
        unit(scramble_mirrored(digits.y, low.y)),
        unit(scramble_mirrored(digits.z, high.x)),
        unit(scramble_mirrored(digits.w, high.y)),
    );
}

/// A mirrored number as one in [0, 1).
fn unit(mirrored: u32) -> f32 {
    return f32(reverseBits(mirrored) >> 8u) * (1.0 / 16777216.0);
}

/// [Veach1997, 9.2.4], β = 2, safe where squares overflow.
fn power_heuristic(pdf: f32, other: f32) -> f32 {
    if pdf >= other {
        let ratio = other / pdf;
        return 1.0 / (1.0 + ratio * ratio);
    }
    let ratio = pdf / other;
    return ratio * ratio / (1.0 + ratio * ratio);
}
