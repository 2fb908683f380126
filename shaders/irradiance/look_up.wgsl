// What records of irradiance know of the light that falls on a surface: `technique/irradiance/mod.rs`, `IrradianceCache::scattered`. A
// table of cells says which may count. Where none does the light octree answers.

@group(3) @binding(4) var<storage, read> records: array<Record>;
/// The flags are `HAS_BASE` and `HAS_CAUSTICS`; what caches name are levels, cells, and records of cells.
@group(3) @binding(5) var<storage, read> record_words: array<u32>;

/// Something answers where no record counts.
const HAS_BASE: u32 = 1u;
/// That knows caustics.
const HAS_CAUSTICS: u32 = 2u;

/// Of a cell in a cache's table: level, place, and its records, first and count; 0 records: no cell.
const CELL_WORDS: u32 = 6u;

/// `index.rs`.
fn hash_of_cell(level: i32, place: vec3i) -> u32 {
    var hash = bitcast<u32>(level) * 0x9e3779b1u;
    for (var axis = 0u; axis < 3u; axis++) {
        hash = (hash ^ bitcast<u32>(place[axis])) * 0x85ebca6bu;
        hash ^= hash >> 15u;
    }
    return hash;
}

/// First and end of the words that name a cell's records.
fn records_of_cell(cache: Cache, level: i32, place: vec3i) -> vec2u {
    var slot = hash_of_cell(level, place) & cache.table_mask;
    // The table has room left, so that this ends.
    loop {
        let at = cache.table_at + CELL_WORDS * slot;
        let count = record_words[at + 5u];
        if count == 0u {
            return vec2u(0u);
        }
        let is_this = bitcast<i32>(record_words[at]) == level
            && bitcast<i32>(record_words[at + 1u]) == place.x
            && bitcast<i32>(record_words[at + 2u]) == place.y
            && bitcast<i32>(record_words[at + 3u]) == place.z;
        if is_this {
            let first = record_words[at + 4u];
            return vec2u(first, first + count);
        }
        slot = (slot + 1u) & cache.table_mask;
    }
    return vec2u(0u);
}

struct WeighedLight {
    irradiance: vec3f,
    /// Mean of `schlick_rise` over it.
    coat_rise: f32,
    /// 0: none knows.
    weight: f32,
}

/// Irradiance by the finest cache that knows it.
fn weighed_irradiance(at: Facing, through_walls: bool) -> WeighedLight {
    let cache_count = record_words[0];
    for (var number = 0u; number < cache_count; number++) {
        let cache = cache_at(number);
        var sum = WeighedLight(vec3f(0.0), 0.0, 0.0);
        for (var words = cache.levels_at; words < cache.levels_end; words += 2u) {
            let level = bitcast<i32>(record_words[words]);
            let per_cell = bitcast<f32>(record_words[words + 1u]);
            // Far outside is as good as outside.
            let place = vec3i(clamp(floor(at.position * per_cell), vec3f(-1e9), vec3f(1e9)));
            let of_cell = records_of_cell(cache, level, place);
            for (var name = of_cell.x; name < of_cell.y; name++) {
                let index = record_words[name];
                let weight = weight_of(cache, index, at, through_walls);
                if weight > 0.0 {
                    sum.irradiance += irradiance_at(index, at) * weight;
                    sum.coat_rise += records[index].coat_rise * weight;
                    sum.weight += weight;
                }
            }
        }
        if sum.weight > 0.0 {
            return WeighedLight(sum.irradiance / sum.weight, sum.coat_rise / sum.weight, sum.weight);
        }
    }
    return WeighedLight(vec3f(0.0), 0.0, 0.0);
}

/// As `light_of_cells`.
fn scattered_light(surface: Surface, wo: vec3f, is_drawn: bool, draw: vec3f) -> ScatteredLight {
    let at = facing_towards(wo, surface.point.position, surface.frame.n, surface.point.n_geo);
    let flags = record_words[1];
    var weighed = weighed_irradiance(at, false);
    if weighed.weight == 0.0 {
        if (flags & HAS_BASE) != 0u {
            return light_of_cells(surface, wo, is_drawn, draw);
        }
        weighed = weighed_irradiance(at, true);
    }
    var light = nothing_known();
    let wo_local = frame_to_local(surface.frame, wo);
    light.indirect = diffuse_of_light(surface.bsdf, wo_local, weighed.coat_rise) * weighed.irradiance;
    if !HAS_FOCUSED && (flags & HAS_CAUSTICS) != 0u {
        light.caustic = light_of_cells(surface, wo, false, draw).caustic;
    }
    return light;
}
