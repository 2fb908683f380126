// Records added up by one step over tiles of the picture: the sums of `splat.wgsl`, in the same order, without drawing.
//
// A tile first finds the box around what its pixels see. Then it goes through the records, so many at a time: its invocations find out which
// spheres reach into the box, and every pixel weighs those. A box leaves out more than rectangles of pixels do: what lies before and
// behind the surface that is seen.

/// What one dispatch does.
struct TileSlice {
    /// Tiles, counted row by row: the first, and the one after the last.
    first_tile: u32,
    end_tile: u32,
    /// Records, of all, likewise.
    first_record: u32,
    end_record: u32,
    /// 1: the cache has none before these. 0: `sums` hold what those say.
    begins: u32,
    /// 1: nor any after these. 0: `sums` are to hold what they say so far.
    ends: u32,
    padding_0: u32,
    padding_1: u32,
}

@group(0) @binding(0) var<uniform> picture: Picture;
@group(0) @binding(1) var<uniform> slice: TileSlice;
@group(0) @binding(2) var<storage, read> points: array<SeenPoint>;
/// Middles and radii of the records' reach.
@group(0) @binding(3) var<storage, read> spheres: array<vec4f>;
@group(0) @binding(4) var<storage, read> records: array<Record>;
@group(0) @binding(5) var<storage, read> record_words: array<u32>;
/// Of weight times irradiance, and of weights, pixel by pixel.
@group(0) @binding(6) var<storage, read_write> sums: array<vec4f>;
@group(0) @binding(7) var<storage, read_write> answers: array<vec4f>;
@group(0) @binding(8) var<storage, read_write> missing: Missing;

const TILE_WIDTH: u32 = 16u;
const TILE_HEIGHT: u32 = 8u;
const TILE_PIXELS: u32 = TILE_WIDTH * TILE_HEIGHT;
/// Bits of a word.
const WORD_BITS: u32 = 32u;
/// Words of records that are looked through at a time: eight records an invocation, between which nobody waits for the others.
const WORDS: u32 = 32u;
/// Share of a way that rounding may take from it, where `weight_of` compares it to a record's reach: far more than its twelve roundings.
const ROUNDED_SHARE: f32 = 1e-5;

/// Corners of the box around what pixels see: first each pixel's own.
var<workgroup> lowest: array<vec3f, TILE_PIXELS>;
var<workgroup> highest: array<vec3f, TILE_PIXELS>;
/// A bit for each record that is looked through: its sphere reaches into the box.
var<workgroup> reaching: array<atomic<u32>, WORDS>;

/// Whether a sphere reaches into a box.
fn reaches_into(sphere: vec4f, low: vec3f, high: vec3f) -> bool {
    let way = max(max(low - sphere.xyz, sphere.xyz - high), vec3f(0.0));
    return !(length(way) * (1.0 - ROUNDED_SHARE) > sphere.w);
}

@compute @workgroup_size(TILE_WIDTH, TILE_HEIGHT)
fn splat_tiles(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_id) place: vec3u,
    @builtin(local_invocation_index) invocation: u32,
) {
    let tile = slice.first_tile + group.y * groups.x + group.x;
    if tile >= slice.end_tile {
        return;
    }
    let columns = (picture.width + TILE_WIDTH - 1u) / TILE_WIDTH;
    let at = vec2u(tile % columns, tile / columns) * vec2u(TILE_WIDTH, TILE_HEIGHT) + place.xy;
    let pixel = at.y * picture.width + at.x;
    // Others take part as well: all wait for each other.
    var is_asked = false;
    var facing = Facing(vec3f(0.0), vec3f(0.0), vec3f(0.0));
    if at.x < picture.width && at.y < picture.height {
        is_asked = points[pixel].sees == SEES_DIFFUSE && !(answers[pixel].w > 0.0);
        facing = Facing(points[pixel].position, points[pixel].normal, points[pixel].n_geo);
    }
    lowest[invocation] = select(vec3f(FLOAT_MAX), facing.position, is_asked);
    highest[invocation] = select(vec3f(-FLOAT_MAX), facing.position, is_asked);
    workgroupBarrier();
    for (var apart = TILE_PIXELS / 2u; apart > 0u; apart /= 2u) {
        if invocation < apart {
            lowest[invocation] = min(lowest[invocation], lowest[invocation + apart]);
            highest[invocation] = max(highest[invocation], highest[invocation + apart]);
        }
        workgroupBarrier();
    }
    let low = workgroupUniformLoad(&lowest[0]);
    let high = workgroupUniformLoad(&highest[0]);
    if low.x > high.x {
        // No pixel asks.
        return;
    }
    let cache = cache_at(picture.cache);
    var sum = vec4f(0.0);
    if is_asked && slice.begins == 0u {
        sum = sums[pixel];
    }
    for (var first = slice.first_record; first < slice.end_record; first += WORDS * WORD_BITS) {
        let count = min(slice.end_record - first, WORDS * WORD_BITS);
        if invocation < WORDS {
            atomicStore(&reaching[invocation], 0u);
        }
        workgroupBarrier();
        for (var number = invocation; number < count; number += TILE_PIXELS) {
            if reaches_into(spheres[first + number], low, high) {
                atomicOr(&reaching[number / WORD_BITS], 1u << (number % WORD_BITS));
            }
        }
        workgroupBarrier();
        for (var number = 0u; is_asked && number < count; number += WORD_BITS) {
            // In the order of the records, on which the bits of sums depend.
            var left = atomicLoad(&reaching[number / WORD_BITS]);
            while left != 0u {
                let record = first + number + firstTrailingBit(left);
                left &= left - 1u;
                let weight = weight_of(cache, record, facing, false);
                if weight > 0.0 {
                    sum += vec4f(irradiance_at(record, facing) * weight, weight);
                }
            }
        }
        workgroupBarrier();
    }
    if !is_asked {
        return;
    }
    if slice.ends != 0u {
        answer_by(sum, pixel);
    } else {
        sums[pixel] = sum;
    }
}
