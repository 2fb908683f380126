// What the light octree knows of the light that falls on a surface: `technique/octree/look_up.rs`, `LightOctree::scattered`,
// of `technique/octree/upload.rs`'s words.

const INNER_CUBES: u32 = 3u;

struct OctreeHeader {
    low: vec3f,
    /// Of cells that are all as large, as are the other lengths.
    cell_m: f32,
    /// Cells along a side.
    cells: u32,
    /// Halvings; 0: nothing is known.
    depth: u32,
    per_sheet_m2: f32,
    /// First word of the first group of each cell, behind the nodes.
    first_sets_at: u32,
    /// How far light is blurred where nothing is known, m.
    blur_max_m: f32,
    /// What lies nearer than so many blurs is lost in them, but no farther than `lost_max_m`.
    lost_blurs: f32,
    lost_max_m: f32,
    /// Share of a group beyond its wall.
    behind_share: f32,
    /// Share of a group within a wall.
    within_share: f32,
    /// 1: cells are smaller in `inner`.
    is_nested: u32,
    padding_0: u32,
    padding_1: u32,
    /// Cubes within the cube: low corner, side.
    inner: array<vec4f, INNER_CUBES>,
}

/// The light of the surfaces of a cell that face about one way.
struct LightSet {
    normal: vec3f,
    plane_m: f32,
    first_vdl: u32,
    first_caustic_vdl: u32,
    end_vdl: u32,
    /// How gently the lights' cosine ends below the horizon.
    reach: f32,
    caustic_reach: f32,
    /// How far indirect light is blurred, m.
    blur_m: f32,
    /// How widely photons of indirect light lie around their lights, of even light.
    evenness: f32,
    /// Bit 0: nothing stands near that could hide its light. The second and third byte: what a coat reflects by the spread of photons around
    /// their lights, of indirect light and of caustics, in 255ths.
    flags: u32,
    /// A plane, beyond which it counts for next to nothing.
    wall: vec4f,
}

@group(3) @binding(0) var<uniform> octree: OctreeHeader;
/// Eight words a node, then the first group of each cell and the end.
@group(3) @binding(1) var<storage, read> octree_words: array<u32>;
@group(3) @binding(2) var<storage, read> light_sets: array<LightSet>;
/// Direction and what the light brings over its softened cosine with its group, as `octree/pack.rs` packs them.
@group(3) @binding(3) var<storage, read> vdls: array<vec2u>;

const NO_CELL: u32 = 0xffffffffu;
const CELL_IS_LEAF: u32 = 0x80000000u;
/// `octree/drawing.rs`.
const DRAW_TRIES: u32 = 16u;
const DRAW_STEPS: vec2f = vec2f(0.7548777, 0.5698403);
const PER_CHANCE_MAX: f32 = 1e30;
/// `octree/lights.rs`.
const ALONG_MIN: f32 = 1e-12;

fn octahedral_fold(square: vec2f) -> vec2f {
    return (1.0 - abs(square.yx)) * vec2f(copysign(1.0, square.x), copysign(1.0, square.y));
}

/// `math/octahedral.rs`.
fn octahedral_decode(code: u32) -> vec3f {
    let square = vec2f(f32(i32(code << 16u) >> 16u), f32(i32(code) >> 16u)) / 32767.0;
    let z = 1.0 - abs(square.x) - abs(square.y);
    return normalize(vec3f(select(square, octahedral_fold(square), z < 0.0), z));
}

/// `octree/pack.rs`: 8, 9, 8 bits of fractions of a power of two, 7 bits of exponent.
fn vdl_irradiance(word: u32) -> vec3f {
    let step = bitcast<f32>(((word >> 25u) + 63u) << 23u);
    let codes = vec3f(f32(word & 0xffu), f32((word >> 8u) & 0x1ffu), f32((word >> 17u) & 0xffu));
    return codes / vec3f(256.0, 512.0, 256.0) * step;
}

/// The mean of max(cos, 0) over a light's photons, about.
fn softened(cosine: f32, reach: f32) -> f32 {
    let above = max(cosine + reach, 0.0);
    return select(above * above * (0.25 / reach), cosine, cosine > reach);
}

/// `octree/cube.rs`: where a point is, in cells from the low corner.
fn place_in_cells(p: vec3f) -> vec3f {
    var place = (p - octree.low) / octree.cell_m;
    if octree.is_nested == 1u {
        var sum = (p - octree.low) / (octree.cell_m * f32(octree.cells));
        for (var index = 0u; index < INNER_CUBES; index++) {
            sum += clamp((p - octree.inner[index].xyz) / octree.inner[index].w, vec3f(0.0), vec3f(1.0));
        }
        place = sum * (f32(octree.cells) / f32(INNER_CUBES + 1u));
    }
    return place;
}

/// Sides of cells at a point over those of cells that are all as large.
fn cell_scale(p: vec3f) -> vec3f {
    var scale = vec3f(1.0);
    if octree.is_nested == 1u {
        var sum = vec3f(1.0);
        for (var index = 0u; index < INNER_CUBES; index++) {
            let inner = octree.inner[index];
            let is_in = (p >= inner.xyz) & (p <= inner.xyz + inner.w);
            sum += select(vec3f(0.0), vec3f(octree.cell_m * f32(octree.cells) / inner.w), is_in);
        }
        scale = f32(INNER_CUBES + 1u) / sum;
    }
    return scale;
}

/// Of three sides the one along the axis that `n` faces most.
fn side_across(sides: vec3f, n: vec3f) -> f32 {
    let size = abs(n);
    if size.x >= size.y && size.x >= size.z {
        return sides.x;
    }
    return select(sides.z, sides.y, size.y >= size.z);
}

/// The leaf of a cell; `NO_CELL` where there is no surface.
fn leaf_of(cell: vec3u) -> u32 {
    var node = 0u;
    var height = octree.depth;
    while height > 0u {
        height -= 1u;
        let octant = ((cell.x >> height) & 1u) | (((cell.y >> height) & 1u) << 1u) | (((cell.z >> height) & 1u) << 2u);
        let child = octree_words[8u * node + octant];
        if child == NO_CELL {
            return NO_CELL;
        }
        node = child;
    }
    return node & ~CELL_IS_LEAF;
}

struct LikeSet {
    /// `NO_CELL`: none faces about like it.
    index: u32,
    share: f32,
}

fn set_like(leaf: u32, p: vec3f, n: vec3f, per_sheet_m2: f32) -> LikeSet {
    var best = LikeSet(NO_CELL, 0.0);
    var best_score = -1e30;
    let end = octree_words[octree.first_sets_at + leaf + 1u];
    for (var place = octree_words[octree.first_sets_at + leaf]; place < end; place++) {
        let cosine = dot(light_sets[place].normal, n);
        if cosine <= LIKE_COS {
            continue;
        }
        let off_m = dot(light_sets[place].normal, p) - light_sets[place].plane_m;
        let squared = min(off_m * off_m * per_sheet_m2, 1e15);
        if cosine - squared > best_score {
            best_score = cosine - squared;
            best = LikeSet(place, 1.0 / (1.0 + squared * squared));
        }
    }
    return best;
}

/// From where photons of a light come on average that do arrive: never from below the horizon.
fn arriving_cos(cos_light: f32, soft: f32) -> f32 {
    return soft / sqrt(max(1.0 - cos_light * cos_light, ALONG_MIN) + soft * soft);
}

/// Lights of one class of a group.
struct LightsOfSet {
    first: u32,
    end: u32,
    reach: f32,
    /// `RiseOfSpread`.
    spread: f32,
}

fn indirect_lights(place: u32) -> LightsOfSet {
    let leaf_set = light_sets[place];
    let spread = f32((leaf_set.flags >> 8u) & 255u) / 255.0;
    return LightsOfSet(leaf_set.first_vdl, leaf_set.first_caustic_vdl, leaf_set.reach, spread);
}

fn caustic_lights(place: u32) -> LightsOfSet {
    let leaf_set = light_sets[place];
    let spread = f32((leaf_set.flags >> 16u) & 255u) / 255.0;
    return LightsOfSet(leaf_set.first_caustic_vdl, leaf_set.end_vdl, leaf_set.caustic_reach, spread);
}

/// What the diffuse lobe sends to the eye of some lights.
fn response(surface: Surface, wo_local: vec3f, n_shade: vec3f, of_set: LightsOfSet) -> vec3f {
    var sum = vec3f(0.0);
    let base = coated_base(surface.bsdf, wo_local);
    let has_base = has_coated_base(surface.bsdf);
    for (var index = of_set.first; index < of_set.end; index++) {
        let direction = octahedral_decode(vdls[index].x);
        let scaled = vdl_irradiance(vdls[index].y);
        let cos_light = dot(n_shade, direction);
        let cosine = softened(cos_light, of_set.reach);
        if has_base {
            var share = cosine;
            if base.rise > 0.0 {
                share *= max(passing(base, arriving_cos(cos_light, cosine)) - base.rise * of_set.spread, 0.0);
            }
            sum += base.scale * scaled * share;
            continue;
        }
        if !(cosine > 0.0) {
            continue;
        }
        // As `arriving_cos` has it.
        let local = frame_to_local(surface.frame, direction);
        let wi = normalize(vec3f(local.xy, copysign(cosine, wo_local.z)));
        sum += eval_bsdf(surface.bsdf, wo_local, wi).diffuse.f_cos * scaled * (cosine / abs(wi.z));
    }
    return sum;
}

/// `octree/drawing.rs`.
struct DrawnLight {
    choice: f32,
    sum: f32,
    /// Its group; `NO_CELL`: no light yet.
    leaf_set: u32,
    index: u32,
}

fn offer(drawn: ptr<function, DrawnLight>, weight: f32, leaf_set: u32, index: u32) {
    if !(weight > 0.0) {
        return;
    }
    (*drawn).sum += weight;
    let share = weight / (*drawn).sum;
    if (*drawn).leaf_set == NO_CELL || (*drawn).choice < share {
        (*drawn).choice /= share;
        (*drawn).leaf_set = leaf_set;
        (*drawn).index = index;
    } else {
        (*drawn).choice = ((*drawn).choice - share) / (1.0 - share);
    }
}

fn is_nearest(index: u32, direction: vec3f, first: u32, end: u32) -> bool {
    let nearness = dot(direction, octahedral_decode(vdls[index].x));
    for (var other = first; other < end; other++) {
        if other != index && dot(direction, octahedral_decode(vdls[other].x)) > nearness {
            return false;
        }
    }
    return true;
}

fn direction_of(drawn: DrawnLight, n_facing: vec3f, turn: vec2f) -> vec3f {
    let first = light_sets[drawn.leaf_set].first_vdl;
    let end = light_sets[drawn.leaf_set].first_caustic_vdl;
    let chosen = octahedral_decode(vdls[drawn.index].x);
    let frame = frame_around(n_facing);
    let evenness = light_sets[drawn.leaf_set].evenness;
    var direction = chosen;
    for (var number = 0u; number < DRAW_TRIES; number++) {
        let u = fract(turn + DRAW_STEPS * f32(number));
        let even = frame_to_world(frame, cosine_hemisphere(u));
        if is_nearest(drawn.index, even, first, end) {
            direction = chosen + (even - chosen) * evenness;
            break;
        }
    }
    direction = normalize(direction);
    return direction - 2.0 * min(dot(direction, n_facing), 0.0) * n_facing;
}

/// - `is_drawn`: a direction that light comes from is asked for, where anything is near
/// - `draw`: random numbers that it is drawn by
fn light_of_cells(surface: Surface, wo: vec3f, is_drawn: bool, draw: vec3f) -> ScatteredLight {
    var light = nothing_known();
    let scale = cell_scale(surface.point.position);
    light.blur_m = octree.blur_max_m * max_component(scale);
    var drawn = DrawnLight(draw.x, 0.0, NO_CELL, 0u);
    if octree.depth == 0u {
        return light;
    }
    let n_geo = surface.point.n_geo;
    let n_facing = select(n_geo, -n_geo, dot(wo, n_geo) < 0.0);
    let n_shade = select(surface.frame.n, -surface.frame.n, dot(wo, surface.frame.n) < 0.0);
    let wo_local = frame_to_local(surface.frame, wo);
    let cells = i32(octree.cells);
    let p = surface.point.position;
    let place = clamp(place_in_cells(p) - 0.5, vec3f(-4.0), vec3f(f32(cells) + 4.0));
    let across = side_across(scale, n_facing);
    let per_sheet_m2 = octree.per_sheet_m2 / (across * across);
    let base = floor(place);
    let fraction = place - base;
    var total = 0.0;
    var blurs_m = 0.0;
    var is_alone = true;
    var found: array<u32, 8>;
    var weights: array<f32, 8>;
    var count = 0u;
    for (var corner = 0; corner < 8; corner++) {
        let offset = vec3i(corner & 1, (corner >> 1u) & 1, corner >> 2u);
        let share = select(1.0 - fraction, fraction, offset == vec3i(1));
        let cell = vec3i(base) + offset;
        var weight = share.x * share.y * share.z;
        if weight <= 0.0 || any(cell < vec3i(0)) || any(cell >= vec3i(cells)) {
            continue;
        }
        let leaf = leaf_of(vec3u(cell));
        if leaf == NO_CELL {
            continue;
        }
        let like = set_like(leaf, p, n_facing, per_sheet_m2);
        if like.index == NO_CELL {
            continue;
        }
        let wall = light_sets[like.index].wall;
        let behind_share = select(octree.behind_share, octree.within_share, wall.w < -1e38);
        weight *= like.share * select(1.0, behind_share, dot(wall.xyz, p) > wall.w);
        total += weight;
        blurs_m += light_sets[like.index].blur_m * weight;
        light.indirect += response(surface, wo_local, n_shade, indirect_lights(like.index)) * weight;
        is_alone = is_alone && (light_sets[like.index].flags & 1u) == 1u;
        found[count] = like.index;
        weights[count] = weight;
        count += 1u;
        // What photons bring takes the place of these.
        if !HAS_FOCUSED {
            let caustic = caustic_lights(like.index);
            if caustic.first < caustic.end {
                light.caustic += response(surface, wo_local, n_shade, caustic) * weight;
            }
        }
    }
    if total > 0.0 {
        light.indirect /= total;
        light.caustic /= total;
        light.blur_m = blurs_m / total;
    } else {
        light.is_missing = true;
    }
    if !is_drawn || is_alone {
        return light;
    }
    for (var place = 0u; place < count; place++) {
        let reach = light_sets[found[place]].reach;
        for (var index = light_sets[found[place]].first_vdl; index < light_sets[found[place]].first_caustic_vdl; index++) {
            let direction = octahedral_decode(vdls[index].x);
            let scaled = max_component(vdl_irradiance(vdls[index].y));
            let cosine = softened(dot(n_shade, direction), reach);
            offer(&drawn, scaled * cosine * weights[place], found[place], index);
        }
    }
    if drawn.leaf_set != NO_CELL {
        var one = indirect_lights(drawn.leaf_set);
        let direction = octahedral_decode(vdls[drawn.index].x);
        let brought = max_component(vdl_irradiance(vdls[drawn.index].y)) * softened(dot(n_shade, direction), one.reach);
        let per_chance = min(drawn.sum / brought, PER_CHANCE_MAX) / total;
        one.first = drawn.index;
        one.end = drawn.index + 1u;
        light.share = response(surface, wo_local, n_shade, one) * per_chance;
        light.lit_from = direction_of(drawn, n_facing, draw.yz);
        light.lost_m = min(octree.lost_blurs * light.blur_m, octree.lost_max_m * max_component(scale));
    }
    return light;
}
