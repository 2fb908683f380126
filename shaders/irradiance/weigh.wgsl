// What a record of irradiance says at a point, and how much that counts: `technique/irradiance/record.rs` and `horizon.rs`, of
// `technique/irradiance/upload.rs`'s records and words.
//
// Another part binds `records: array<Record>` and `record_words: array<u32>`: how many caches there are, the finest first; two flags;
// `CACHE_WORDS` of each cache; then what those name.

/// A record, with 24 bytes of its horizon where vectors leave room.
struct Record {
    position: vec3f,
    /// It does not count beyond, m.
    reach_m: f32,
    normal: vec3f,
    /// How much of a way its gradients count for: less than all where it reaches farther than its radius allows.
    way_share: f32,
    n_geo: vec3f,
    /// Nothing nearer is hidden, m.
    nearest_m: f32,
    irradiance: vec3f,
    /// Mean of `schlick_rise` over its light.
    coat_rise: f32,
    turning_red: vec3f,
    ways_0: u32,
    turning_green: vec3f,
    ways_1: u32,
    turning_blue: vec3f,
    ways_2: u32,
    moving_red: vec3f,
    rises_0: u32,
    moving_green: vec3f,
    rises_1: u32,
    moving_blue: vec3f,
    rises_2: u32,
}

const CACHES_AT: u32 = 2u;
const CACHE_WORDS: u32 = 6u;

/// `irradiance/record.rs`.
const INVERSE_WEIGHT_MIN: f32 = 1e-4;
const SAME_SURFACE_COS: f32 = 0.5;
const BEHIND: f32 = 0.05;

/// `irradiance/horizon.rs`.
const SECTORS: u32 = 12u;
const WAYS_PER_OCTAVE: u32 = 16u;
const ENDLESS: u32 = 255u;
const SILHOUETTE: u32 = 128u;
const RISE_CODE_MAX: u32 = 127u;
const RISE_MAX: f32 = 0.45;
const BETWEEN: f32 = 0.965;
const HALF_ROOT_3: f32 = 0.8660254;
const TAN_30: f32 = 0.57735026;
const TAN_60: f32 = 1.7320508;

/// What `upload.rs` writes of a cache.
struct Cache {
    accuracy: f32,
    is_smooth: bool,
    /// Words of levels in use: the level, and one over the width of its cells.
    levels_at: u32,
    levels_end: u32,
    table_at: u32,
    /// Places of the table less one: one less than a power of two.
    table_mask: u32,
}

fn cache_at(index: u32) -> Cache {
    let at = CACHES_AT + CACHE_WORDS * index;
    return Cache(
        bitcast<f32>(record_words[at]),
        record_words[at + 1u] != 0u,
        record_words[at + 2u],
        record_words[at + 3u],
        record_words[at + 4u],
        record_words[at + 5u],
    );
}

fn sector_of(way: vec2f) -> u32 {
    let size = abs(way);
    let third = select(0u, 1u, size.y >= TAN_30 * size.x) + select(0u, 1u, size.y >= TAN_60 * size.x);
    if way.x >= 0.0 {
        return select(11u - third, third, way.y >= 0.0);
    }
    return select(6u + third, 5u - third, way.y >= 0.0);
}

fn direction_of_sector(sector: u32) -> vec2f {
    let third = sector % 3u;
    var direction = vec2f(1.0, 0.0);
    if third == 1u {
        direction = vec2f(HALF_ROOT_3, 0.5);
    } else if third == 2u {
        direction = vec2f(0.5, HALF_ROOT_3);
    }
    let quarter = (sector / 3u) % 4u;
    if (quarter & 1u) != 0u {
        direction = vec2f(-direction.y, direction.x);
    }
    return select(direction, -direction, (quarter & 2u) != 0u);
}

fn sector_code(words: vec3u, index: u32) -> u32 {
    let word = select(select(words.z, words.y, index < 8u), words.x, index < 4u);
    return (word >> (8u * (index & 3u))) & 0xffu;
}

/// Open way in a direction, m, of a code that is not `ENDLESS`.
fn open_way_m(nearest_m: f32, code: u32) -> f32 {
    let octaves = bitcast<f32>((code / WAYS_PER_OCTAVE + 127u) << 23u);
    return nearest_m / BETWEEN * octaves * exp2(f32(code % WAYS_PER_OCTAVE) / f32(WAYS_PER_OCTAVE));
}

fn perp_dot(a: vec2f, b: vec2f) -> f32 {
    return a.x * b.y - a.y * b.x;
}

/// `Horizon::hides`.
fn is_hidden_from(index: u32, way: vec3f) -> bool {
    let nearest_m = records[index].nearest_m;
    let along_m = length(way.xy);
    if !(along_m > nearest_m) {
        return false;
    }
    let sector = sector_of(way.xy);
    let next = (sector + 1u) % SECTORS;
    let rises = vec3u(records[index].rises_0, records[index].rises_1, records[index].rises_2);
    let rise_code = sector_code(rises, sector);
    let rise = min(rise_code & RISE_CODE_MAX, sector_code(rises, next) & RISE_CODE_MAX);
    if way.z >= f32(rise) / f32(RISE_CODE_MAX) * RISE_MAX * along_m {
        return false;
    }
    let ways = vec3u(records[index].ways_0, records[index].ways_1, records[index].ways_2);
    let codes = vec2u(sector_code(ways, sector), sector_code(ways, next));
    let ways_m = vec2f(open_way_m(nearest_m, codes.x), open_way_m(nearest_m, codes.y));
    if (rise_code & SILHOUETTE) != 0u {
        return codes.x != ENDLESS && along_m > ways_m.x || codes.y != ENDLESS && along_m > ways_m.y;
    }
    if any(codes == vec2u(ENDLESS)) {
        return false;
    }
    let a = direction_of_sector(sector) * ways_m.x;
    let b = direction_of_sector(next) * ways_m.y;
    return perp_dot(b - a, way.xy - a) < 0.0;
}

/// `Record::weight`, or that through walls.
fn weight_of(cache: Cache, index: u32, at: Facing, through_walls: bool) -> f32 {
    let way = at.position - records[index].position;
    let reach_m = records[index].reach_m;
    let distance = length(way) * (cache.accuracy / reach_m);
    let normal = records[index].normal;
    let inverse = distance + sqrt(clamp(1.0 - dot(at.normal, normal), 0.0, 2.0));
    if !(inverse < cache.accuracy) {
        return 0.0;
    }
    let n_geo = records[index].n_geo;
    if dot(n_geo, at.n_geo) < SAME_SURFACE_COS || dot(way, at.normal + normal) * 0.5 < -BEHIND * reach_m {
        return 0.0;
    }
    var weight = 1.0 / max(inverse, INVERSE_WEIGHT_MIN);
    if cache.is_smooth {
        weight = max(weight - 1.0 / cache.accuracy, 0.0);
    }
    let is_far = length(way) > records[index].nearest_m;
    if weight > 0.0 && is_far && !through_walls && is_hidden_from(index, frame_to_local(frame_around(n_geo), way)) {
        return 0.0;
    }
    return weight;
}

/// `Record::irradiance_at`.
fn irradiance_at(index: u32, at: Facing) -> vec3f {
    let way = (at.position - records[index].position) * records[index].way_share;
    let turn = cross(records[index].normal, at.normal);
    let change = vec3f(
        dot(turn, records[index].turning_red) + dot(way, records[index].moving_red),
        dot(turn, records[index].turning_green) + dot(way, records[index].moving_green),
        dot(turn, records[index].turning_blue) + dot(way, records[index].moving_blue),
    );
    return max(records[index].irradiance + change, vec3f(0.0));
}
