// Lights as `transport/light` samples them: the same tree, the same choices for the same numbers.

/// A light that stands somewhere, or a directional one.
struct Light {
    /// Where; of a directional light the way its light goes; of a triangle corner and scale of the part that this is of it.
    position: vec3f,
    /// 0 triangle, 1 point, 2 spot, 3 directional.
    kind: u32,
    /// W/sr, or W/m² of a directional one.
    intensity: vec3f,
    instance: u32,
    axis: vec3f,
    triangle: u32,
    cos_inner: f32,
    cos_outer: f32,
    area_m2: f32,
    is_two_sided: u32,
}

struct LightNode {
    low: vec3f,
    /// Inner: the second child; the first follows at once. Leaf: the light.
    next: u32,
    high: vec3f,
    /// 1: leaf; 2: shines from both sides.
    flags: u32,
    axis: vec3f,
    intensity: f32,
    cos_normals: f32,
    cos_emission: f32,
    /// One past the last node below this one.
    end: u32,
    padding: u32,
}

@group(1) @binding(6) var<storage, read> lights: array<Light>;
@group(1) @binding(7) var<storage, read> light_nodes: array<LightNode>;

struct LightSample {
    exists: bool,
    wi: vec3f,
    radiance: vec3f,
    pdf: f32,
    is_delta: bool,
    /// 0 infinitely far, 1 a point, 2 a triangle.
    origin: u32,
    target_in_render: vec3f,
    /// Of a light without extent, its number; NO_INDEX of others.
    number: u32,
    instance: u32,
    triangle: u32,
    b1: f32,
    b2: f32,
    point: SurfacePoint,
}

fn cos_of_difference(sin_a: f32, cos_a: f32, sin_b: f32, cos_b: f32) -> f32 {
    return select(cos_a * cos_b + sin_a * sin_b, 1.0, cos_a > cos_b);
}

fn sin_of(cosine: f32) -> f32 {
    return sqrt(max(1.0 - cosine * cosine, 0.0));
}

/// Largest number that importances are told apart by: sums of a few stay floats.
const IMPORTANCE_MAX: f32 = 1e37;

/// `LEVEL` of `transport/light/bounds.rs`.
const LEVEL: f32 = 1e-3;

/// A cosine to a box that reaches so far beyond a plane, `nearest_m` away at least.
fn at_most(cosine: f32, reach_m: f32, nearest_m: f32) -> f32 {
    if nearest_m > 0.0 {
        return min(cosine, reach_m / nearest_m);
    }
    return cosine;
}

/// `LightBounds::importance`; `n` is a surface's, never zero.
fn importance(node: u32, p: vec3f, n: vec3f) -> f32 {
    let low = light_nodes[node].low;
    let high = light_nodes[node].high;
    let axis = light_nodes[node].axis;
    let half_way = (high - low) * 0.5;
    let from_centre = p - (low + high) * 0.5;
    let distance_m = length(from_centre);
    let radius_m = length(half_way);
    let least_m = LEVEL * (distance_m + radius_m);
    let lit_m = dot(abs(n), half_way) - dot(n, from_centre);
    let is_two_sided = (light_nodes[node].flags & 2u) != 0u;
    let ahead_m = dot(axis, from_centre);
    let shining_m = select(ahead_m, abs(ahead_m), is_two_sided) + dot(abs(axis), half_way);
    let cos_normals = light_nodes[node].cos_normals;
    let faces_one_way = cos_normals >= 1.0;
    if lit_m < -least_m || (faces_one_way && shining_m < -least_m) {
        return 0.0;
    }
    let nearest_m = length(max(abs(from_centre) - half_way, vec3f(0.0)));
    var to_point = axis;
    if distance_m > 0.0 {
        to_point = from_centre / distance_m;
    }
    var sin_b = 0.0;
    var cos_b = -1.0;
    if distance_m > radius_m {
        sin_b = radius_m / distance_m;
        cos_b = sin_of(sin_b);
    }
    var cos_w = dot(axis, to_point);
    if is_two_sided {
        cos_w = abs(cos_w);
    }
    if !faces_one_way {
        cos_w = cos_of_difference(sin_of(cos_w), cos_w, sin_of(cos_normals), cos_normals);
    }
    var cos_emitted = cos_of_difference(sin_of(cos_w), cos_w, sin_b, cos_b);
    if cos_emitted <= light_nodes[node].cos_emission {
        return 0.0;
    }
    if faces_one_way {
        cos_emitted = at_most(cos_emitted, max(shining_m, least_m), nearest_m);
    }
    let cos_i = -dot(to_point, n);
    var cos_received = cos_of_difference(sin_of(cos_i), cos_i, sin_b, cos_b);
    cos_received = at_most(cos_received, max(lit_m, least_m), nearest_m);
    if cos_emitted <= 0.0 || cos_received <= 0.0 {
        return 0.0;
    }
    let floored_m = max(distance_m, radius_m);
    let floored = max(floored_m * floored_m, LEAST_NORMAL);
    return min(light_nodes[node].intensity * cos_emitted * cos_received / floored, IMPORTANCE_MAX);
}

/// Chances of the two children of an inner node; below 0 where neither can reach the point.
fn child_chances(node: u32, p: vec3f, n: vec3f) -> vec2f {
    let first = importance(node + 1u, p, n);
    let second = importance(light_nodes[node].next, p, n);
    let sum = first + second;
    if !(sum > 0.0) {
        return vec2f(-1.0);
    }
    return vec2f(first, second) / sum;
}

/// `FEW` of `transport/light/tree.rs`.
const FEW: u32 = 16u;

/// True where so few lights lie below a node that all are compared.
fn is_few(node: u32) -> bool {
    return light_nodes[node].end - node < 2u * FEW;
}

/// Lights of one place with the weights that a point chooses among them by.
struct FewLights {
    lights: array<u32, FEW>,
    weights: array<f32, FEW>,
    count: u32,
    sum: f32,
}

/// `LightTree::few`.
fn few_lights(node: u32, p: vec3f, n: vec3f) -> FewLights {
    var few: FewLights;
    var largest = 0.0;
    let end = light_nodes[node].end;
    for (var at = node; at < end; at++) {
        if (light_nodes[at].flags & 1u) != 0u {
            let weight = importance(at, p, n);
            few.lights[few.count] = light_nodes[at].next;
            few.weights[few.count] = weight;
            few.count++;
            largest = max(largest, weight);
        }
    }
    if largest > 0.0 {
        for (var i = 0u; i < few.count; i++) {
            let root = sqrt(few.weights[i] / largest);
            few.weights[i] = root * sqrt(root);
            few.sum += few.weights[i];
        }
    }
    return few;
}

struct ChosenLight {
    light: u32,
    probability: f32,
}

/// Probability 0: no light.
fn choose_light(p: vec3f, n: vec3f, number: f32) -> ChosenLight {
    var u = number;
    var at = 0u;
    var probability = 1.0;
    while !is_few(at) {
        let chances = child_chances(at, p, n);
        if chances.x < 0.0 {
            return ChosenLight(0u, 0.0);
        }
        if u < chances.x {
            u = min(u / chances.x, ONE_LESS);
            probability *= chances.x;
            at += 1u;
        } else {
            u = min((u - chances.x) / chances.y, ONE_LESS);
            probability *= chances.y;
            at = light_nodes[at].next;
        }
    }
    var chosen = ChosenLight(0u, 0.0);
    let few = few_lights(at, p, n);
    var left = u * few.sum;
    for (var i = 0u; i < few.count; i++) {
        let weight = few.weights[i];
        if weight > 0.0 {
            // Rounding may leave something over after the last.
            chosen = ChosenLight(few.lights[i], probability * (weight / few.sum));
            if left < weight {
                break;
            }
            left -= weight;
        }
    }
    return chosen;
}

/// Probability with which [`choose_light`] returns a light.
fn probability_of_light(p: vec3f, n: vec3f, light: u32) -> f32 {
    let trail_at = scene.trails_at + 2u * light;
    var trail = vec2u(tables[trail_at], tables[trail_at + 1u]);
    var at = 0u;
    var probability = 1.0;
    while !is_few(at) {
        let chances = child_chances(at, p, n);
        if chances.x < 0.0 {
            return 0.0;
        }
        if (trail.x & 1u) == 0u {
            probability *= chances.x;
            at += 1u;
        } else {
            probability *= chances.y;
            at = light_nodes[at].next;
        }
        trail = vec2u((trail.x >> 1u) | (trail.y << 31u), trail.y >> 1u);
    }
    let few = few_lights(at, p, n);
    for (var i = 0u; i < few.count; i++) {
        if few.lights[i] == light && few.weights[i] > 0.0 {
            return probability * (few.weights[i] / few.sum);
        }
    }
    return 0.0;
}

fn infinite_count() -> u32 {
    return scene.directional_count + select(0u, 1u, scene.environment_kind != 0u);
}

/// x: chance of each far light; y: that of the tree.
fn light_shares() -> vec2f {
    let has_tree = scene.light_node_count > 0u;
    let each = 1.0 / f32(max(infinite_count() + select(0u, 1u, has_tree), 1u));
    return vec2f(each, select(0.0, each, has_tree));
}

/// Density of an evenly drawn point of a triangle as a direction; 0 from behind.
fn area_pdf(n: vec3f, area_m2: f32, is_two_sided: bool, wi: vec3f, distance2: f32) -> f32 {
    var cosine = -dot(n, wi);
    if is_two_sided {
        cosine = abs(cosine);
    }
    if !(cosine > 0.0) {
        return 0.0;
    }
    let covered = cosine * area_m2;
    // Beyond this the quotient is no float.
    if !(covered * 1e38 > distance2) {
        return 0.0;
    }
    return distance2 / covered;
}

fn spot_falloff(cosine: f32, cos_inner: f32, cos_outer: f32) -> f32 {
    let t = clamp((cosine - cos_outer) / max(cos_inner - cos_outer, 1e-6), 0.0, 1.0);
    return t * t;
}

fn no_light() -> LightSample {
    var sample: LightSample;
    sample.exists = false;
    sample.number = NO_INDEX;
    return sample;
}

/// `Lights::sample` with the numbers `u` (choice, two for the place).
fn sample_light(p: vec3f, n: vec3f, u: vec3f) -> LightSample {
    let shares = light_shares();
    var sample = no_light();
    if u.x < shares.y {
        let chosen = choose_light(p, n, u.x / shares.y);
        if chosen.probability <= 0.0 {
            return sample;
        }
        return sample_local(chosen.light, chosen.probability * shares.y, p, u.yz);
    }
    let count = infinite_count();
    if count == 0u {
        return sample;
    }
    let index = min(u32((u.x - shares.y) / shares.x), count - 1u);
    sample.origin = 0u;
    if index < scene.directional_count {
        let light = lights[scene.directional_at + index];
        sample.exists = true;
        sample.wi = -light.position;
        sample.radiance = light.intensity;
        sample.pdf = shares.x;
        sample.is_delta = true;
        sample.number = scene.directional_at + index;
        return sample;
    }
    let drawn = sample_environment(n, u.yz);
    if !(drawn.w > 0.0) {
        return sample;
    }
    sample.exists = true;
    sample.wi = drawn.xyz;
    sample.radiance = environment_radiance(drawn.xyz);
    sample.pdf = drawn.w * shares.x;
    sample.is_delta = false;
    return sample;
}

fn sample_local(index: u32, chance: f32, p: vec3f, u: vec2f) -> LightSample {
    var sample = no_light();
    let light = lights[index];
    sample.pdf = chance;
    if light.kind != 0u {
        let to_light = light.position - p;
        let distance2 = length_squared(to_light);
        let wi = normalize_or(to_light, vec3f(0.0));
        if is_black(wi) || !(distance2 > LEAST_NORMAL) {
            return sample;
        }
        sample.wi = wi;
        sample.radiance = light.intensity * (1.0 / distance2);
        if light.kind == 2u {
            sample.radiance *= spot_falloff(-dot(wi, light.axis), light.cos_inner, light.cos_outer);
        }
        sample.is_delta = true;
        sample.number = index;
        sample.origin = 1u;
        sample.target_in_render = light.position;
        sample.exists = !is_black(sample.radiance);
        return sample;
    }
    let weights = light.position.xy + light.position.z * triangle_weights(u);
    sample.b1 = weights.x;
    sample.b2 = weights.y;
    sample.instance = light.instance;
    sample.triangle = light.triangle;
    sample.point = surface_point(light.instance, light.triangle, weights.x, weights.y);
    let to_light = sample.point.position - p;
    let wi = normalize_or(to_light, vec3f(0.0));
    let pdf = area_pdf(sample.point.n_geo, light.area_m2, light.is_two_sided != 0u, wi, length_squared(to_light));
    if is_black(wi) || !(pdf > 0.0) {
        return sample;
    }
    sample.wi = wi;
    sample.pdf = pdf * chance;
    sample.is_delta = false;
    sample.origin = 2u;
    sample.exists = true;
    return sample;
}

/// `Cut::part_of`.
fn part_of(level: u32, b1: f32, b2: f32) -> u32 {
    let pieces = 1u << level;
    let place = max(vec2f(b1, b2) * f32(pieces), vec2f(0.0));
    let row = min(u32(place.x), pieces - 1u);
    let column = min(u32(place.y), pieces - 1u - row);
    let is_turned = (place.x - f32(row)) + (place.y - f32(column)) > 1.0 && column + 1u < pieces - row;
    return row * (2u * pieces - row) + 2u * column + select(0u, 1u, is_turned);
}

/// `Lights::pdf_of_triangle`: the density of drawing `wi` from (`p`, `n`) to this point of a triangle.
fn pdf_of_triangle(p: vec3f, n: vec3f, wi: vec3f, hit: Hit, on_light: SurfacePoint) -> f32 {
    let runs_at = placements[hit.instance].runs_at;
    for (var run = 0u; run < placements[hit.instance].run_count; run++) {
        let at = runs_at + 4u * run;
        let number = hit.triangle - geometry[at];
        if hit.triangle >= geometry[at] && number < geometry[at + 1u] {
            let level = geometry[at + 3u];
            let light = geometry[at + 2u] + (number << (2u * level)) + part_of(level, hit.b1, hit.b2);
            let distance2 = length_squared(on_light.position - p);
            let pdf = area_pdf(on_light.n_geo, lights[light].area_m2, lights[light].is_two_sided != 0u, wi, distance2);
            if pdf <= 0.0 {
                return 0.0;
            }
            return pdf * probability_of_light(p, n, light) * light_shares().y;
        }
    }
    return 0.0;
}

// What arrives from outside: `transport/light/environment.rs`.

fn environment_texel_of(wi: vec3f) -> vec2u {
    let width = f32(scene.environment_width);
    let height = f32(scene.environment_height);
    var turn = (atan2(wi.x, -wi.z) + scene.environment_rotation_rad) / TAU;
    turn -= floor(turn);
    let v = acos(clamp(wi.y, -1.0, 1.0)) / PI;
    return vec2u(
        min(u32(turn * width), scene.environment_width - 1u),
        min(u32(v * height), scene.environment_height - 1u),
    );
}

fn environment_radiance(wi: vec3f) -> vec3f {
    if scene.environment_kind == 0u {
        return vec3f(0.0);
    }
    if !HAS_SKY_PICTURE || scene.environment_kind == 1u {
        return scene.environment_radiance;
    }
    let place = environment_texel_of(wi);
    let index = place.y * scene.environment_width + place.x;
    // Floats, or bytes of a picture that was not meant to hold radiance.
    return texel(scene.environment_at, scene.environment_flags, index).xyz * scene.environment_radiance;
}

/// Word of `tables` that holds the running sum `index` of those that begin at `at`.
fn table_sum(at: u32, index: u32) -> f32 {
    return bitcast<f32>(tables[at + index]);
}

/// Share of the whole that the interval `index` has.
fn share_of(at: u32, count: u32, index: u32) -> f32 {
    let below = select(0.0, table_sum(at, max(index, 1u) - 1u), index > 0u);
    return (table_sum(at, index) - below) / table_sum(at, count - 1u);
}

fn environment_pdf(n: vec3f, wi: vec3f) -> f32 {
    if scene.environment_kind == 0u {
        return 0.0;
    }
    if !HAS_SKY_PICTURE || scene.environment_kind == 1u {
        return cosine_hemisphere_pdf(dot(n, wi));
    }
    let place = environment_texel_of(wi);
    let row_at = scene.environment_sums_at + scene.environment_height + place.y * scene.environment_width;
    let of_row = share_of(scene.environment_sums_at, scene.environment_height, place.y);
    if of_row <= 0.0 || table_sum(row_at, scene.environment_width - 1u) <= 0.0 {
        return 0.0;
    }
    let chance = of_row * share_of(row_at, scene.environment_width, place.x);
    let sin_theta = sqrt(max(1.0 - wi.y * wi.y, 0.0));
    let texel_sr = sin_theta * (PI / f32(scene.environment_height)) * (TAU / f32(scene.environment_width));
    return select(0.0, chance / max(texel_sr, LEAST_NORMAL), texel_sr > 0.0);
}

/// x: the interval of running sums that `u` falls into; y: where in it. x below 0: none.
fn choose_interval(at: u32, count: u32, u: f32) -> vec2f {
    let total = table_sum(at, count - 1u);
    if !(total > 0.0) {
        return vec2f(-1.0, 0.0);
    }
    let wanted = u * total;
    var low = 0u;
    var high = count;
    while low < high {
        let middle = (low + high) / 2u;
        if table_sum(at, middle) <= wanted {
            low = middle + 1u;
        } else {
            high = middle;
        }
    }
    let index = min(low, count - 1u);
    let below = select(0.0, table_sum(at, max(index, 1u) - 1u), index > 0u);
    let share = table_sum(at, index) - below;
    if !(share > 0.0) {
        return vec2f(-1.0, 0.0);
    }
    return vec2f(f32(index), clamp((wanted - below) / share, 0.0, ONE_LESS));
}

/// xyz: a direction for a surface that faces `n`; w: its density, 0 for none.
fn sample_environment(n: vec3f, u: vec2f) -> vec4f {
    if !HAS_SKY_PICTURE || scene.environment_kind == 1u {
        let local = cosine_hemisphere(u);
        return vec4f(frame_to_world(frame_around(n), local), cosine_hemisphere_pdf(local.z));
    }
    let row = choose_interval(scene.environment_sums_at, scene.environment_height, u.y);
    if row.x < 0.0 {
        return vec4f(0.0);
    }
    let row_at = scene.environment_sums_at + scene.environment_height + u32(row.x) * scene.environment_width;
    let column = choose_interval(row_at, scene.environment_width, u.x);
    if column.x < 0.0 {
        return vec4f(0.0);
    }
    let theta = (row.x + row.y) / f32(scene.environment_height) * PI;
    let phi = (column.x + column.y) / f32(scene.environment_width) * TAU - scene.environment_rotation_rad;
    let wi = vec3f(sin(theta) * sin(phi), cos(theta), -sin(theta) * cos(phi));
    return vec4f(wi, environment_pdf(n, wi));
}
