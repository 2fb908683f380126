// Takes each path to the surface that its ray met: light seen there, a light sample for the shadow rays to come, and where
// the path goes on. `cpu.rs`, `Tracer::advance`.
//
// Where `LOOKS_PAST`, diffuse surfaces that are too near to be answered for are looked past. Where `SHADOWS_KNOWN`, what lies
// near the first diffuse surface from the eye shadows what is known of the light there, and is looked at. What a path passed
// is a word: bits 0 to 3 as below, from bit 4 up how many surfaces it looked past.

/// The first diffuse surface was too near to be answered for, or what lies near it is looked at.
const IS_NEAR: u32 = 1u;
/// A mirror or glass has sent the path on since.
const IS_BY_MIRRORS: u32 = 2u;
/// Some surface was neither a mirror nor clear glass, or the path went where glass shows less from.
const IS_CLOUDED: u32 = 4u;
/// Some surface was glass.
const IS_BY_GLASS: u32 = 8u;
const NEAR_COUNT_SHIFT: u32 = 4u;

/// Those of classes that are asked for; all; those of other lobes than the diffuse one.
const FOLLOWED_WANTED: u32 = 0u;
const FOLLOWED_ALL: u32 = 1u;
const FOLLOWED_SPECULAR: u32 = 2u;

@compute @workgroup_size(WORKGROUP)
fn shade(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= counters.ray_count {
        return;
    }
    let slot = slot_at(id.x);
    if advance(slot) {
        go_on(slot);
    }
}

fn advance(slot: u32) -> bool {
    var path = paths[slot];
    let hit = hits[slot];
    var passing = path.passing;
    if SHADOWS_KNOWN && hit.instance != NO_INDEX && hit.t < path.lost_m {
        passing |= IS_NEAR;
    }
    path.lost_m = 0.0;
    let is_beyond_near = (passing & IS_NEAR) != 0u && meets_diffuse(path.class_so_far);
    // What lights send from there by way of mirrors or glass is known as the near surface's caustics.
    let is_beyond_mirrors = is_beyond_near && (passing & IS_BY_MIRRORS) != 0u;
    // From the eye, or by way of mirrors alone: what shines is shown as it is.
    let is_straight = (passing & (IS_CLOUDED | IS_BY_GLASS)) == 0u;
    if hit.instance == NO_INDEX {
        if is_straight {
            note_shining(slot);
        }
        if path.bounce > 0u && (passing & IS_CLOUDED) == 0u {
            note_beyond(slot, path.throughput, -path.direction);
        }
        if !is_beyond_mirrors && !has_gathered(path, 2u) {
            add_environment(slot, path);
        }
        return false;
    }
    let surface = surface_at(hit.instance, hit.triangle, hit.b1, hit.b2, path.direction);
    if HAS_GLASS && surface.bsdf.kind == GLASS && dot(path.direction, surface.frame.n) > 0.0 {
        path.medium = surface.inside;
    }
    path.throughput *= transmittance(path.medium, hit.t);
    if path.bounce == 0u {
        note_first(slot, shown_albedo(surface), surface.frame.n, surface.point.position, hit.t);
    } else if (passing & IS_CLOUDED) == 0u && !is_clear(surface.bsdf) {
        note_beyond(slot, path.throughput * shown_albedo(surface), surface.frame.n);
    }
    if is_straight && any(surface.emitted + surface.unlit > vec3f(0.0)) {
        note_shining(slot);
    }
    if !is_beyond_mirrors {
        add_emission(slot, path, hit, surface);
    }
    if path.bounce >= pass_header.bounces_end || !(is_beyond_near || are_traced_beyond(path.class_so_far)) {
        return false;
    }
    let sampler = sampler_of(slot, path);
    // At the first diffuse surface seen from the eye, or by way of one that was looked past: what is known of the light there,
    // by one scattering less.
    let is_asked = HAS_SECONDARY && (!meets_diffuse(path.class_so_far) || is_beyond_near)
        && path.bounce + 1u < pass_header.bounces_end && has_diffuse(surface.bsdf);
    var known = nothing_known();
    var is_near = false;
    if is_asked {
        let is_drawn = SHADOWS_KNOWN && pass_header.index >= pass_header.shadowed_from && !is_beyond_near;
        var draw = vec3f(0.0);
        if is_drawn {
            draw = four(sampler, FROM_DIMENSION + path.bounce).xyz;
        }
        known = dimmed(scattered_light(surface, -path.direction, is_drawn, draw));
        let is_too_near = LOOKS_PAST && hit.t < NEAR_BLURS * known.blur_m;
        // Never where scatterings are bounded.
        let is_passed = known.is_missing && pass_header.bounces_end >= BOUNCES_END;
        is_near = (passing >> NEAR_COUNT_SHIFT) < NEAR_MAX && (is_too_near || is_passed);
    }
    let followed = select(FOLLOWED_WANTED, select(FOLLOWED_SPECULAR, FOLLOWED_ALL, is_near), is_beyond_near);
    add_light_sample(slot, path, hit, surface, sampler, followed);
    if is_asked {
        path.lost_m = known.lost_m;
        if !is_near {
            // As much of each colour as the light that may be hidden has of it, and no less than nothing.
            let hidden = select(vec3f(0.0), min(known.indirect, known.share), known.lost_m > 0.0);
            add_radiance(slot, INDIRECT, path.throughput * (known.indirect - hidden));
            if known.lost_m > 0.0 {
                add_unless_hidden(slot, path, hit, surface, known, hidden);
            }
        }
        let class_of_caustic = class_after(class_after(path.class_so_far, false), true);
        add_radiance(slot, class_of_caustic, path.throughput * known.caustic);
        // Beyond a near surface the path stays so, whatever it meets.
        passing = (passing & ~IS_NEAR) | select(0u, IS_NEAR, is_near || is_beyond_near);
        passing += select(0u, 1u << NEAR_COUNT_SHIFT, is_near);
    }
    let is_gathering = HAS_FOCUSED && gather_focused(slot, path, surface, is_beyond_near);
    return scatter(slot, &path, hit, surface, sampler, followed, passing, is_gathering);
}

/// `Dimmed` of `technique/products`.
fn dimmed(light: ScatteredLight) -> ScatteredLight {
    var known = light;
    known.indirect *= pass_header.dimmed;
    known.caustic *= pass_header.dimmed;
    known.share *= pass_header.dimmed;
    return known;
}

/// For the layer of albedo, and to take noise off.
fn shown_albedo(surface: Surface) -> vec3f {
    return albedo_of(surface.bsdf) + surface.unlit;
}

/// So many scatterings ago or more, by mirrors alone since, a gloss gathered all the light that lights send by mirrors.
fn has_gathered(path: Path, scatterings: u32) -> bool {
    return HAS_FOCUSED && (pass_header.focus & IS_ASKING) != 0u && path.since_gathered >= scatterings;
}

/// `Tracer::gather_focused`.
fn gather_focused(slot: u32, path: Path, surface: Surface, is_beyond_near: bool) -> bool {
    let is_left = path.since_gathered == 0u && !is_beyond_near;
    let shown = shows_focused(path, surface, has_broad_gloss(surface.bsdf) && is_left);
    if !shown.is_any {
        return false;
    }
    let focused = focused_light(surface, -path.direction, shown.scatterings_max);
    if shown.is_diffuse {
        let class_of_light = class_after(class_after(path.class_so_far, false), true);
        add_radiance(slot, class_of_light, path.throughput * focused.diffuse);
    }
    if shown.is_glossy {
        let class_of_light = class_after(class_after(path.class_so_far, true), true);
        add_radiance(slot, class_of_light, path.throughput * focused.glossy);
    }
    return shown.is_glossy;
}

/// By which of its lobes a surface shows light that only mirrors and glass sent on before.
struct ShownFocused {
    is_any: bool,
    is_diffuse: bool,
    is_glossy: bool,
    /// Scatterings before, at most.
    scatterings_max: u32,
}

/// `Tracer::shows_focused`.
///
/// - `is_shown_by_gloss`: its gloss is one of those that do, and none before has gathered that
fn shows_focused(path: Path, surface: Surface, is_shown_by_gloss: bool) -> ShownFocused {
    let is_shown = (pass_header.focus & SHOWS_CAUSTICS) != 0u;
    let is_glossy = is_shown_by_gloss && (is_shown || path.class_so_far == INDIRECT);
    // From surfaces that are seen, nothing else.
    let is_diffuse = has_diffuse(surface.bsdf) && (is_shown || meets_diffuse(path.class_so_far));
    let is_any = (is_glossy || is_diffuse) && path.bounce + 1u < pass_header.bounces_end;
    // What is looked up is bounded by itself, whatever lies between the surface and the eye.
    let is_bounded = pass_header.bounces_end < BOUNCES_END && (pass_header.focus & IS_ASKING) == 0u;
    let scatterings_max = select(0xffffffffu, pass_header.bounces_end - path.bounce - 1u, is_bounded);
    return ShownFocused(is_any, is_diffuse, is_glossy, scatterings_max);
}

/// What something near may hide of the known light.
fn add_unless_hidden(
    slot: u32,
    path: Path,
    hit: Hit,
    surface: Surface,
    known: ScatteredLight,
    hidden: vec3f,
) {
    var shadow: Shadow;
    shadow.origin = origin_towards(surface.point, known.lit_from);
    shadow.direction = known.lit_from;
    shadow.t_max = known.lost_m;
    shadow.classes = INDIRECT | (INDIRECT << 8u);
    shadow.diffuse = path.throughput * hidden;
    shadow.light = NO_INDEX;
    shadow.light_instance = NO_INDEX;
    shadow.glossy = vec3f(0.0);
    shadow.light_triangle = NO_INDEX;
    shadow.left_instance = hit.instance;
    shadow.left_triangle = hit.triangle;
    shadow.by_panes = NO_INDEX;
    ask_for(OF_KNOWN * pass_header.capacity + slot, shadow);
}

/// Its ray is traced in the step to come.
fn ask_for(place: u32, shadow: Shadow) {
    shadows[place] = shadow;
    let queued = atomicAdd(&counters.next_shadow_count, 1u);
    queues[SHADOWS * pass_header.capacity + queued] = place;
}

fn add_environment(slot: u32, path: Path) {
    let radiance = environment_radiance(path.direction);
    if is_black(radiance) {
        return;
    }
    var weight = 1.0;
    if path.last_pdf >= 0.0 {
        weight = power_heuristic(path.last_pdf, environment_pdf(path.last_n, path.direction) * light_shares().x);
    }
    add_radiance(slot, path.class_so_far, path.throughput * radiance * weight);
}

fn add_emission(slot: u32, path: Path, hit: Hit, surface: Surface) {
    if !meets_diffuse(path.class_so_far) && !is_black(surface.unlit) {
        add_radiance(slot, path.class_so_far, path.throughput * surface.unlit);
    }
    if is_black(surface.emitted) || has_gathered(path, 2u) {
        return;
    }
    var weight = 1.0;
    if path.last_pdf >= 0.0 {
        let light_pdf = pdf_of_triangle(
            path.last_position,
            path.last_n,
            path.direction,
            hit,
            surface.point,
        );
        weight = power_heuristic(path.last_pdf, light_pdf);
    }
    add_radiance(slot, path.class_so_far, path.throughput * surface.emitted * weight);
}

/// - `followed`: the rays that go on from here, which light sampling competes with
fn add_light_sample(
    slot: u32,
    path: Path,
    hit: Hit,
    surface: Surface,
    sampler: PixelSampler,
    followed: u32,
) {
    if !has_density(surface.bsdf) {
        return;
    }
    let u = four(sampler, 2u + 2u * path.bounce);
    let n = surface.frame.n;
    let facing = select(n, -n, dot(path.direction, n) > 0.0);
    let light = sample_light(surface.point.position, facing, u.xyz);
    if !light.exists {
        return;
    }
    let wo = frame_to_local(surface.frame, -path.direction);
    let value = eval_bsdf(surface.bsdf, wo, frame_to_local(surface.frame, light.wi));
    let is_dark = is_black(value.diffuse.f_cos) && is_black(value.glossy.f_cos);
    if is_dark || !may_scatter(surface, -path.direction, light.wi) {
        return;
    }
    var radiance = light.radiance;
    var shadow: Shadow;
    shadow.origin = origin_towards(surface.point, light.wi);
    shadow.direction = light.wi;
    shadow.t_max = FLOAT_MAX;
    shadow.light = light.number;
    shadow.light_instance = NO_INDEX;
    shadow.light_triangle = NO_INDEX;
    shadow.by_panes = NO_INDEX;
    var medium_share = vec3f(1.0);
    if light.origin != 0u {
        var end = light.target_in_render;
        if light.origin == 2u {
            if HAS_MASKS && !is_present(light.instance, light.triangle, light.b1, light.b2) {
                return;
            }
            let weights = vec3f(1.0 - light.b1 - light.b2, light.b1, light.b2);
            let from_front = dot(light.wi, light.point.n_geo) < 0.0;
            let material = material_of(light.instance, light.triangle);
            radiance = emitted(light.instance, light.triangle, material, weights, from_front);
            end = origin_towards(light.point, -light.wi);
            shadow.light_instance = light.instance;
            shadow.light_triangle = light.triangle;
        }
        if is_black(radiance) {
            return;
        }
        shadow.direction = end - shadow.origin;
        let distance_m = length(shadow.direction);
        // `room_at_point`.
        let room_m = select(max_component(abs(end)) * POINT_ROOM, 0.0, light.origin == 2u);
        shadow.t_max = 1.0 - room_m / distance_m;
        medium_share = transmittance(path.medium, distance_m);
    }
    let arriving = path.throughput * radiance * (1.0 / light.pdf) * medium_share;
    let class_of_diffuse = class_after(path.class_so_far, false);
    let class_of_glossy = class_after(path.class_so_far, true);
    shadow.diffuse = vec3f(0.0);
    shadow.glossy = vec3f(0.0);
    if followed != FOLLOWED_WANTED || is_traced(class_of_diffuse) {
        // Where the diffuse lobe is not followed, nothing competes.
        let is_alone = light.is_delta || followed == FOLLOWED_SPECULAR;
        let weight = select(power_heuristic(light.pdf, value.diffuse.pdf_solid_angle), 1.0, is_alone);
        shadow.diffuse = arriving * value.diffuse.f_cos * weight;
    }
    // Light straight to a glossy lobe is a caustic of the near surface before, and known there.
    if followed == FOLLOWED_WANTED && is_traced(class_of_glossy) && !has_gathered(path, 1u) {
        let weight = select(power_heuristic(light.pdf, value.glossy.pdf_solid_angle), 1.0, light.is_delta);
        shadow.glossy = arriving * value.glossy.f_cos * weight;
    }
    shadow.classes = class_of_diffuse | (class_of_glossy << 8u);
    shadow.left_instance = hit.instance;
    shadow.left_triangle = hit.triangle;
    if HAS_GLASS && light.origin == 0u {
        shadow.by_panes = note_by_panes(slot, path, surface, light.is_delta, followed, value, arriving);
    }
    ask_for(slot, shadow);
}

/// Notes what the surface makes of a light from infinitely far that panes let through, where that is left to light sampling:
/// `Tracer::shown_through_panes`. Returns where; NO_INDEX: nowhere.
///
/// - `arriving`: without anything in between
fn note_by_panes(
    slot: u32,
    path: Path,
    surface: Surface,
    is_sun: bool,
    followed: u32,
    value: BsdfValue,
    arriving: vec3f,
) -> u32 {
    if (pass_header.focus & select(LEAVES_SKY, LEAVES_SUNS, is_sun)) == 0u {
        return NO_INDEX;
    }
    // A narrow gloss finds the sky by where it sends paths, and no sun.
    // What a gloss before has gathered is not sampled again, unless photons stop where light can be sampled.
    let stops = is_sun && (pass_header.focus & IS_ASKING) == 0u;
    let is_left = (path.since_gathered == 0u || stops) && followed == FOLLOWED_WANTED;
    let shown = shows_focused(path, surface, (is_sun || has_broad_gloss(surface.bsdf)) && is_left);
    if !shown.is_any {
        return NO_INDEX;
    }
    var beyond: Shadow;
    let class_of_diffuse = class_after(class_after(path.class_so_far, false), true);
    let class_of_glossy = class_after(class_after(path.class_so_far, true), true);
    beyond.classes = class_of_diffuse | (class_of_glossy << 8u);
    beyond.diffuse = select(vec3f(0.0), arriving * value.diffuse.f_cos, shown.is_diffuse);
    beyond.glossy = select(vec3f(0.0), arriving * value.glossy.f_cos, shown.is_glossy);
    // As photons are, that are bounded by themselves.
    beyond.light = min(shown.scatterings_max, pass_header.bounces_end - 1u);
    let place = BY_PANES * pass_header.capacity + slot;
    shadows[place] = beyond;
    return place;
}

fn scatter(
    slot: u32,
    path: ptr<function, Path>,
    hit: Hit,
    surface: Surface,
    sampler: PixelSampler,
    followed: u32,
    passing: u32,
    is_gathering: bool,
) -> bool {
    let u = four(sampler, 1u + 2u * (*path).bounce);
    let wo = -(*path).direction;
    let wo_local = frame_to_local(surface.frame, wo);
    let drawn = sample_bsdf(surface.bsdf, wo_local, u.xyz);
    if !drawn.exists {
        return false;
    }
    let class_now = class_after((*path).class_so_far, drawn.is_specular);
    let is_wanted = is_traced(class_now) || are_traced_beyond(class_now);
    if !select(is_wanted, followed == FOLLOWED_ALL || drawn.is_specular, followed != FOLLOWED_WANTED) {
        return false;
    }
    let wi = frame_to_world(surface.frame, drawn.wi);
    if !may_scatter(surface, wo, wi) {
        return false;
    }
    (*path).throughput *= drawn.weight;
    (*path).eta_squared *= drawn.eta_squared;
    (*path).class_so_far = class_now;
    (*path).bounce += 1u;
    (*path).last_pdf = drawn.pdf_solid_angle;
    (*path).last_position = surface.point.position;
    (*path).last_n = select(surface.frame.n, -surface.frame.n, dot(wo, surface.frame.n) < 0.0);
    let stays_clear =
        is_clear(surface.bsdf) && (!HAS_GLASS || shows_most_from(surface.bsdf, wo_local, drawn.wi));
    if HAS_GLASS && wo_local.z * drawn.wi.z < 0.0 {
        (*path).medium = select(0u, surface.inside, drawn.wi.z < 0.0);
    }
    (*path).origin = origin_towards(surface.point, wi);
    (*path).direction = wi;
    (*path).left_instance = hit.instance;
    (*path).left_triangle = hit.triangle;
    if is_black((*path).throughput) {
        return false;
    }
    if (*path).bounce > ROULETTE_FREE_BOUNCES {
        // Roots: see the CPU's.
        let carried = max_component((*path).throughput) * (*path).eta_squared;
        let survival = min(sqrt(sqrt(carried)), SURVIVAL_MAX);
        if u.w >= survival {
            return false;
        }
        (*path).throughput *= 1.0 / survival;
    }
    (*path).passing = (passing & ~IS_BY_MIRRORS)
        | select(0u, IS_BY_MIRRORS, drawn.is_specular)
        | select(IS_CLOUDED, 0u, stays_clear)
        | select(0u, IS_BY_GLASS, HAS_GLASS && surface.bsdf.kind == GLASS);
    if drawn.is_specular {
        (*path).lost_m = 0.0;
    }
    let goes_on = drawn.is_specular && (is_gathering || (*path).since_gathered > 0u);
    (*path).since_gathered = select(0u, (*path).since_gathered + 1u, goes_on);
    paths[slot] = *path;
    return true;
}
