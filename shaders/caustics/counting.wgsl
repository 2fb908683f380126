// What steps of counting a sketch share.

@group(0) @binding(0) var<uniform> sketch: Sketch;
@group(0) @binding(1) var<storage, read> photons: array<Photon>;
@group(0) @binding(2) var<storage, read_write> words: array<atomic<u32>>;
/// Photons in each pixel of the picture and its margin; then of each row those left of every pixel's corner: one more than pixels.
@group(0) @binding(3) var<storage, read_write> rows: array<atomic<u32>>;
/// Of each photon which width its window has: `width_count` where no window holds enough of them, NOWHERE where it shows nowhere.
@group(0) @binding(4) var<storage, read_write> chosen: array<u32>;
/// Entries as they come.
@group(0) @binding(5) var<storage, read_write> unsorted: array<u32>;

const NOWHERE: u32 = 0xffffffffu;
/// Photons in a window for it not to be widened.
const ENOUGH: u32 = 8u;

fn number_of(group: vec3u, groups: vec3u, invocation: u32) -> u32 {
    return (group.y * groups.x + group.x) * WORKGROUP + invocation;
}

/// Pixels of a row with the margin, and of a column.
fn extent_px() -> vec2i {
    return vec2i(sketch.width, sketch.height) + vec2i(2 * sketch.margin);
}

fn row_at(row: i32) -> u32 {
    return u32(row) * u32(extent_px().x + 1);
}

fn place_of(photon: u32) -> vec2i {
    let at = sketch.places_at + SKETCH_PLACE_WORDS * photon;
    return vec2i(bitcast<i32>(atomicLoad(&words[at])), bitcast<i32>(atomicLoad(&words[at + 1u])));
}

/// Cells that a photon's window reaches into.
struct Reached {
    /// Column and row of the first.
    first: vec2i,
    /// Behind the last.
    end: vec2i,
    windows: Windows,
}

/// Only of photons that show somewhere.
fn reached_by(photon: u32) -> Reached {
    let windows = sketch.windows[min(chosen[photon], sketch.width_count - 1u)];
    let place = place_of(photon);
    let first = max(place - vec2i(windows.half_px), vec2i(0));
    let last = min(place + vec2i(windows.half_px), vec2i(sketch.width, sketch.height) - vec2i(1));
    // Before the picture's first pixel there is no cell.
    if any(last < first) {
        return Reached(vec2i(0), vec2i(0), windows);
    }
    let log2 = vec2u(windows.cell_log2);
    return Reached(first >> log2, (last >> log2) + vec2i(1), windows);
}

/// First word of a cell.
fn cell_at(windows: Windows, column: i32, row: i32) -> u32 {
    return windows.cells_at + SKETCH_CELL_WORDS * (u32(row) * windows.columns + u32(column));
}
