// A pixel and those around it, as the noise filter compares them: `film/denoise/kernel.rs`, whose numbers are prepended, with the order of
// its sums. Some rows of a picture at once, laid out as `film/denoise/planes.rs` has them.

struct Band {
    /// Pixels of a row.
    width: u32,
    rows: u32,
    /// Numbers from one plane of a row to the next.
    stride: u32,
    /// How far apart the pixels are that are joined.
    step: u32,
    /// 1: a pixel's own variance is believed.
    is_believed: u32,
}

@group(0) @binding(0) var<uniform> band: Band;
/// What tells surfaces apart, as bits: floats may be assumed to be neither infinite nor NaN.
@group(0) @binding(1) var<storage, read> surfaces: array<u32>;
/// Light by channel, and the variance of its luminance, as bits as well.
@group(0) @binding(2) var<storage, read> light: array<u32>;
/// What a step makes of it.
@group(0) @binding(3) var<storage, read_write> made: array<f32>;

const INFINITY_BITS: u32 = 0x7f800000u;
/// Differences of normals and albedos that are as good as any larger one, whose square might leave the range.
const OFF_MAX: f32 = 1e3;
/// The same of depths, once they are told by how far surfaces differ.
const APART_MAX: f32 = 1e37;

/// What is no number counts as zero. Films have none.
fn number(bits: u32) -> f32 {
    return bitcast<f32>(select(bits, 0u, (bits & INFINITY_BITS) == INFINITY_BITS));
}

fn surface_number(place: u32, plane: u32) -> f32 {
    return clamp(number(surfaces[place + plane * band.stride]), -SURFACE_MAX, SURFACE_MAX);
}

fn surface_numbers(place: u32, plane: u32) -> vec3f {
    return vec3f(
        surface_number(place, plane),
        surface_number(place, plane + 1u),
        surface_number(place, plane + 2u),
    );
}

/// Where the numbers of a pixel lie that has so many.
fn place_of(row: u32, column: u32, planes: u32) -> u32 {
    return row * planes * band.stride + MARGIN + column;
}

fn light_at(row: u32, column: u32) -> vec3f {
    let place = place_of(row, column, LIGHT_PLANES);
    let rgb = vec3f(
        number(light[place]),
        number(light[place + band.stride]),
        number(light[place + 2u * band.stride]),
    );
    return clamp(rgb, vec3f(0.0), vec3f(LIGHT_MAX));
}

fn variance_at(row: u32, column: u32) -> f32 {
    let place = place_of(row, column, LIGHT_PLANES) + 3u * band.stride;
    return clamp(number(light[place]), 0.0, VARIANCE_MAX);
}

fn luminance_of(rgb: vec3f) -> f32 {
    return rgb.x * DIFFERENCE_RED + rgb.y * DIFFERENCE_GREEN + rgb.z * DIFFERENCE_BLUE;
}

/// One of the eight others around a pixel.
struct Beside {
    is_there: bool,
    row: u32,
    column: u32,
    /// How far it is, in pixels.
    across: f32,
    down: f32,
    /// Before surfaces or light are looked at.
    weight: f32,
}

/// - `other`: 0 to 8, row by row; 4 is the pixel itself
fn beside(other: u32, row: u32, column: u32, step: u32) -> Beside {
    // One step too far, since there are no numbers below zero.
    let there = vec2u(column + (other % 3u) * step, row + (other / 3u) * step);
    let is_there = all(there >= vec2u(step)) && all(there < vec2u(band.width, band.rows) + step);
    let is_same_column = other % 3u == 1u;
    let is_same_row = other / 3u == 1u;
    return Beside(
        is_there && other != 4u,
        there.y - step,
        there.x - step,
        select(f32(step), 0.0, is_same_column),
        select(f32(step), 0.0, is_same_row),
        select(CORNER_WEIGHT, SIDE_WEIGHT, is_same_column || is_same_row),
    );
}

/// The surface of a pixel.
struct Own {
    normal: vec3f,
    albedo: vec3f,
    depth: f32,
    per_depth: f32,
    slope: vec2f,
}

fn own_at(row: u32, column: u32) -> Own {
    let place = place_of(row, column, SURFACE_PLANES);
    return Own(
        surface_numbers(place, NORMAL_PLANE),
        surface_numbers(place, ALBEDO_PLANE),
        surface_number(place, DEPTH_PLANE),
        max(surface_number(place, PER_DEPTH_PLANE), 0.0),
        vec2f(surface_number(place, SLOPE_PLANE), surface_number(place, SLOPE_PLANE + 1u)),
    );
}

fn squares(off: vec3f) -> f32 {
    let near = min(abs(off), vec3f(OFF_MAX));
    return near.x * near.x + near.y * near.y + near.z * near.z;
}

/// How far it differs from that of another.
fn apart_from(own: Own, other: Beside) -> f32 {
    let place = place_of(other.row, other.column, SURFACE_PLANES);
    let expected = own.slope.x * (SLOPE * other.across) + own.slope.y * (SLOPE * other.down);
    var farther = max(abs(own.depth - surface_number(place, DEPTH_PLANE)) - expected, 0.0);
    if own.per_depth > 1.0 {
        farther = min(farther, APART_MAX / own.per_depth);
    }
    return farther * own.per_depth
        + squares(own.normal - surface_numbers(place, NORMAL_PLANE)) * PER_NORMAL
        + squares(own.albedo - surface_numbers(place, ALBEDO_PLANE)) * PER_ALBEDO;
}

/// e to the minus what pixels differ by, nearly: nothing from 8 on.
fn weight_of(apart: f32) -> f32 {
    let base = max(1.0 - apart * PER_APART, 0.0);
    let fourth = (base * base) * (base * base);
    return fourth * fourth;
}

/// Row and column of an invocation; beyond the last row for those that are too many.
fn pixel_of(group: vec3u, groups: vec3u, invocation: u32) -> vec2u {
    let index = (group.y * groups.x + group.x) * WORKGROUP + invocation;
    return vec2u(index / band.width, index % band.width);
}

fn make(row: u32, column: u32, rgb: vec3f, variance: f32) {
    let place = place_of(row, column, LIGHT_PLANES);
    made[place] = rgb.x;
    made[place + band.stride] = rgb.y;
    made[place + 2u * band.stride] = rgb.z;
    made[place + 3u * band.stride] = variance;
}
