// What a screen shows of one film, or of two blended: `PictureParts::mixed` of `film/picture.rs`, then `film/tone_map.rs`. What is
// prepended, and the numbers of tone maps, are Rust's.

struct Showing {
    /// Rows of the matrix before the tone map's curve; w is padding, here and below.
    into: array<vec4f, 3>,
    /// Rows of the one after it.
    out_of: array<vec4f, 3>,
    /// Nine numbers of the curve, as `Fit` of `film/tone_map.rs` has them.
    curve: array<vec4f, 3>,
    /// What half the radiance is multiplied by.
    factor: f32,
    /// Half the radiance beyond which a channel is as bright as any: the product might leave the range.
    bright: f32,
    /// `TONE_…`; any other: cut off above 1.
    tone_map: u32,
    /// Pixels of a row.
    width: u32,
    /// Row of the picture that the first pixel lies in.
    row_first: u32,
    pixel_count: u32,
    /// Tiles that have a weight, along x and y; none where only one film is shown.
    tile_columns: u32,
    tile_rows: u32,
}

@group(0) @binding(0) var<uniform> showing: Showing;
/// Radiance, three floats a pixel, as bits: floats may be assumed to be neither infinite nor NaN.
@group(0) @binding(1) var<storage, read> own: array<u32>;
/// The same of the path-traced film.
@group(0) @binding(2) var<storage, read> traced: array<u32>;
/// Of the path-traced film at the middles of tiles, row by row.
@group(0) @binding(3) var<storage, read> weights: array<f32>;
/// The smallest values that round to codes 0 to 255.
@group(0) @binding(4) var<storage, read> thresholds: array<f32>;
/// Codes, three bytes a pixel, least significant first: four pixels in three words.
@group(0) @binding(5) var<storage, read_write> words: array<u32>;

const INFINITY_BITS: u32 = 0x7f800000u;
/// Below what any curve tells from black, and what a logarithm can be taken of.
const DARKEST: f32 = 1e-30;

fn is_finite(bits: u32) -> bool {
    return (bits & INFINITY_BITS) != INFINITY_BITS;
}

/// Radiance, exposed, in [0, RADIANCE_MAX]. Halves come in because the sum of two floats that are weighed may not leave the range then.
fn exposed(half: f32) -> f32 {
    if !(half > 0.0) {
        return 0.0;
    }
    if half > showing.bright {
        return RADIANCE_MAX;
    }
    return min(half * showing.factor, RADIANCE_MAX);
}

/// Whether a channel of that weight makes the sum NaN or minus infinity, which count as black: NaN does, minus infinity, and an infinity
/// times zero.
fn is_broken(bits: u32, weight: f32) -> bool {
    return !is_finite(bits) && !(bits == INFINITY_BITS && weight > 0.0);
}

fn exposed_blend(own_bits: u32, traced_bits: u32, weight: f32) -> f32 {
    let own_weight = 1.0 - weight;
    if is_finite(own_bits) && is_finite(traced_bits) {
        let own_half = 0.5 * bitcast<f32>(own_bits);
        let traced_half = 0.5 * bitcast<f32>(traced_bits);
        return exposed(own_half * own_weight + traced_half * weight);
    }
    if is_broken(own_bits, own_weight) || is_broken(traced_bits, weight) {
        return 0.0;
    }
    return RADIANCE_MAX;
}

fn exposed_alone(bits: u32) -> f32 {
    if is_finite(bits) {
        return exposed(0.5 * bitcast<f32>(bits));
    }
    return select(0.0, RADIANCE_MAX, bits == INFINITY_BITS);
}

/// The two tiles between whose middles a pixel lies, along one axis, and how far it is from the first to the second.
struct Between {
    first: u32,
    second: u32,
    across: f32,
}

/// Without rounding, as tiles are a power of two wide.
fn between(pixel: u32, count: u32) -> Between {
    let place = clamp((f32(pixel) + 0.5) * (1.0 / f32(TILE_SIDE)) - 0.5, 0.0, f32(count - 1u));
    let first = u32(place);
    return Between(first, min(first + 1u, count - 1u), place - f32(first));
}

fn weight_in_row(row: u32, columns: Between) -> f32 {
    let start = row * showing.tile_columns;
    return weights[start + columns.first] * (1.0 - columns.across) + weights[start + columns.second] * columns.across;
}

fn weight_at(pixel: vec2u) -> f32 {
    let columns = between(pixel.x, showing.tile_columns);
    let rows = between(pixel.y, showing.tile_rows);
    return weight_in_row(rows.first, columns) * (1.0 - rows.across) + weight_in_row(rows.second, columns) * rows.across;
}

/// - `index`: of the pixels that are shown now
fn radiance_at(index: u32) -> vec3f {
    let at = 3u * index;
    if showing.tile_columns == 0u {
        return vec3f(exposed_alone(own[at]), exposed_alone(own[at + 1u]), exposed_alone(own[at + 2u]));
    }
    let weight = weight_at(vec2u(index % showing.width, showing.row_first + index / showing.width));
    return vec3f(
        exposed_blend(own[at], traced[at], weight),
        exposed_blend(own[at + 1u], traced[at + 1u], weight),
        exposed_blend(own[at + 2u], traced[at + 2u], weight),
    );
}

/// Matrices by rows.
fn into_curve(v: vec3f) -> vec3f {
    return vec3f(dot(showing.into[0].xyz, v), dot(showing.into[1].xyz, v), dot(showing.into[2].xyz, v));
}

fn out_of_curve(v: vec3f) -> vec3f {
    return vec3f(dot(showing.out_of[0].xyz, v), dot(showing.out_of[1].xyz, v), dot(showing.out_of[2].xyz, v));
}

fn aces(v: vec3f) -> vec3f {
    let curve = showing.curve[0];
    return (v * (v + curve.x) - curve.y) / (v * (curve.z * v + curve.w) + showing.curve[1].x);
}

fn agx(v: vec3f) -> vec3f {
    let black = showing.curve[0].x;
    let white = showing.curve[0].y;
    let stops = clamp(log2(max(v, vec3f(DARKEST))), vec3f(black), vec3f(white));
    let x = (stops - black) / (white - black);
    var sum = vec3f(showing.curve[0].z);
    sum = sum * x + showing.curve[0].w;
    sum = sum * x + showing.curve[1].x;
    sum = sum * x + showing.curve[1].y;
    sum = sum * x + showing.curve[1].z;
    sum = sum * x + showing.curve[1].w;
    return sum * x + showing.curve[2].x;
}

/// In [0, 1]; before AgX's last step, which the thresholds take in.
fn encoded(radiance: vec3f) -> vec3f {
    var mapped = radiance;
    switch showing.tone_map {
        case TONE_REINHARD: {
            mapped = radiance * (1.0 / (1.0 + dot(showing.curve[0].xyz, radiance)));
        }
        case TONE_ACES: {
            mapped = out_of_curve(aces(into_curve(radiance)));
        }
        case TONE_AGX: {
            mapped = out_of_curve(agx(into_curve(radiance)));
        }
        default: {}
    }
    return clamp(mapped, vec3f(0.0), vec3f(1.0));
}

/// The last code whose threshold is not above.
fn code(value: f32) -> u32 {
    var last = 0u;
    for (var step = 128u; step > 0u; step >>= 1u) {
        if value >= thresholds[last + step] {
            last += step;
        }
    }
    return last;
}

/// Three bytes; none beyond the last pixel.
fn codes_at(index: u32) -> u32 {
    if index >= showing.pixel_count {
        return 0u;
    }
    let shown = encoded(radiance_at(index));
    return code(shown.x) | (code(shown.y) << 8u) | (code(shown.z) << 16u);
}

@compute @workgroup_size(WORKGROUP)
fn show(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) invocation: u32,
) {
    let four = (group.y * groups.x + group.x) * WORKGROUP + invocation;
    if 4u * four >= showing.pixel_count {
        return;
    }
    let first = codes_at(4u * four);
    let second = codes_at(4u * four + 1u);
    let third = codes_at(4u * four + 2u);
    let fourth = codes_at(4u * four + 3u);
    words[3u * four] = first | (second << 24u);
    words[3u * four + 1u] = (second >> 8u) | (third << 16u);
    words[3u * four + 2u] = (third >> 16u) | (fourth << 8u);
}
