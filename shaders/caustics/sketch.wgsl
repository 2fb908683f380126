// A sketch of caustics as a camera sees it, of `technique/path/gpu/sketch.rs`: photons in lists, one for each cell of the picture
// that their windows reach into, for each width of windows. Twin of `technique/caustics/screen/mod.rs`.
//
// The words of a sketch: how many entries there are; what photons count away from the middle, for each width; `SKETCH_PLACE_WORDS` of each photon,
// the column and row of its pixel; `SKETCH_CELL_WORDS` of each cell, how many entries it has and where they end; entries: numbers of photons.

struct Photon {
    position: vec3f,
    /// Square of how far it is blurred, m²; 0 in a sketch.
    r2: f32,
    flux_w: vec3f,
    /// Before it fell here.
    scatterings: u32,
    /// Where it came from.
    direction: vec3f,
    padding_0: u32,
    /// Of the surface on the side it fell on.
    normal: vec3f,
    padding_1: u32,
}

/// Photons with windows of one width.
struct Windows {
    /// Pixels on each side of the middle one.
    half_px: i32,
    /// Binary logarithm of the width of a cell, px.
    cell_log2: u32,
    /// Cells in a row.
    columns: u32,
    /// First word of what a photon counts so many rows and columns away, `[half + 1, half + 1]`.
    weights_at: u32,
    /// First word of the cells.
    cells_at: u32,
    padding_0: u32,
    padding_1: u32,
    padding_2: u32,
}

struct Sketch {
    origin: vec3f,
    half_width: f32,
    right: vec3f,
    half_height: f32,
    up: vec3f,
    is_perspective: u32,
    back: vec3f,
    /// Widths that windows have; 0: this is no sketch.
    width_count: u32,
    /// Of the picture, px.
    width: i32,
    height: i32,
    /// Pixels around it from which windows may reach into it.
    margin: i32,
    photon_count: u32,
    /// First word of the photons' places.
    places_at: u32,
    /// Cells of all widths, which lie one after the other.
    cell_count: u32,
    /// First word of the entries.
    entries_at: u32,
    padding_0: u32,
    /// The narrowest first.
    windows: array<Windows, 5>,
}

const SKETCH_PLACE_WORDS: u32 = 2u;
const SKETCH_CELL_WORDS: u32 = 2u;
/// Half pictures from the middle beyond which nothing is near the picture: its margin ends at no more than 9, where that is one pixel wide.
const HALVES_END: f32 = 1e3;

struct SketchPixel {
    at: vec2i,
    is_there: bool,
}

/// Half the width or height of what is seen at some depth, m.
fn sketch_half(half: f32, depth_m: f32) -> f32 {
    return half * select(1.0, depth_m, sketch.is_perspective != 0u);
}

/// The pixel of the picture, or of a margin around it, where a point shows: `View::project`.
fn sketch_pixel(p: vec3f, margin: i32) -> SketchPixel {
    let nowhere = SketchPixel(vec2i(0), false);
    let offset = p - sketch.origin;
    let depth_m = -dot(offset, sketch.back);
    if !(depth_m > 0.0) {
        return nowhere;
    }
    let along = vec2f(dot(offset, sketch.right), dot(offset, sketch.up));
    let half = vec2f(sketch_half(sketch.half_width, depth_m), sketch_half(sketch.half_height, depth_m));
    // Nothing is divided by that makes infinity of it.
    if !all(abs(along) < HALVES_END * half) {
        return nowhere;
    }
    let from_middle = along / half;
    let size = vec2i(sketch.width, sketch.height);
    let at = 0.5 * vec2f(1.0 + from_middle.x, 1.0 - from_middle.y) * vec2f(size);
    let pixel = vec2i(floor(at));
    let is_there = all(pixel >= vec2i(-margin)) && all(pixel < size + vec2i(margin));
    return SketchPixel(pixel, is_there);
}
