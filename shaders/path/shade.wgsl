// Takes each path to the surface that its ray met: light seen there, a light sample for the shadow rays to come, and where
// the path goes on. `cpu.rs`, `Tracer::advance`, without maps of caustics and records.

@compute @workgroup_size(WORKGROUP)
fn shade(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= counters.ray_count {
        return;
    }
    let slot = queues[counters.parity * pass_header.capacity + id.x];
    if advance(slot) {
        let place = atomicAdd(&counters.next_ray_count, 1u);
        queues[(1u - counters.parity) * pass_header.capacity + place] = slot;
    }
}

fn advance(slot: u32) -> bool {
    var path = paths[slot];
    let hit = hits[slot];
    if hit.instance == NO_INDEX {
        add_environment(slot, path);
        return false;
    }
    let surface = surface_at(hit.instance, hit.triangle, hit.b1, hit.b2, path.direction);
    if HAS_GLASS && surface.bsdf.kind == GLASS && dot(path.direction, surface.frame.n) > 0.0 {
        path.medium = surface.inside;
    }
    path.throughput *= transmittance(path.medium, hit.t);
    if path.bounce == 0u {
        let albedo = albedo_of(surface.bsdf) + surface.unlit;
        samples[slot].albedo_red = albedo.x;
        samples[slot].albedo_green = albedo.y;
        samples[slot].albedo_blue = albedo.z;
        samples[slot].normal = surface.frame.n;
        samples[slot].depth_m = max(dot(pass_header.origin - surface.point.position, pass_header.back), 0.0);
    }
    add_emission(slot, path, hit, surface);
    if path.bounce >= pass_header.bounces_end || !are_traced_beyond(path.class_so_far) {
        return false;
    }
    let sampler = PixelSampler(path.key, pass_header.index);
    add_light_sample(slot, path, hit, surface, sampler);
    // At the first diffuse surface seen from the eye: what is known of the light there, by one scattering less.
    let is_asked = HAS_SECONDARY && path.class_so_far == EMITTED && path.bounce + 1u < pass_header.bounces_end;
    if is_asked && has_diffuse(surface.bsdf) {
        let known = scattered_light(surface, -path.direction);
        add_radiance(slot, INDIRECT, path.throughput * known.indirect);
        add_radiance(slot, CAUSTIC, path.throughput * known.caustic);
    }
    return scatter(slot, &path, hit, surface, sampler);
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
    if path.class_so_far == EMITTED && !is_black(surface.unlit) {
        add_radiance(slot, EMITTED, path.throughput * surface.unlit);
    }
    if is_black(surface.emitted) {
        return;
    }
    var weight = 1.0;
    if path.last_pdf >= 0.0 {
        let light_pdf = pdf_of_triangle(
            path.last_position,
            path.last_n,
            path.direction,
            hit.instance,
            hit.triangle,
            surface.point,
        );
        weight = power_heuristic(path.last_pdf, light_pdf);
    }
    add_radiance(slot, path.class_so_far, path.throughput * surface.emitted * weight);
}

fn add_light_sample(slot: u32, path: Path, hit: Hit, surface: Surface, sampler: PixelSampler) {
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
    if is_black(value.diffuse.f_cos) && is_black(value.glossy.f_cos) {
        return;
    }
    var radiance = light.radiance;
    var shadow: Shadow;
    shadow.origin = origin_towards(surface.point, light.wi);
    shadow.direction = light.wi;
    shadow.t_max = FLOAT_MAX;
    shadow.light_instance = NO_INDEX;
    shadow.light_triangle = NO_INDEX;
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
        shadow.t_max = 1.0;
        medium_share = transmittance(path.medium, length(shadow.direction));
    }
    let arriving = path.throughput * radiance * (1.0 / light.pdf) * medium_share;
    let class_of_diffuse = class_after(path.class_so_far, false);
    let class_of_glossy = class_after(path.class_so_far, true);
    shadow.diffuse = vec3f(0.0);
    shadow.glossy = vec3f(0.0);
    if is_traced(class_of_diffuse) {
        let weight = select(power_heuristic(light.pdf, value.diffuse.pdf_solid_angle), 1.0, light.is_delta);
        shadow.diffuse = arriving * value.diffuse.f_cos * weight;
    }
    if is_traced(class_of_glossy) {
        let weight = select(power_heuristic(light.pdf, value.glossy.pdf_solid_angle), 1.0, light.is_delta);
        shadow.glossy = arriving * value.glossy.f_cos * weight;
    }
    shadow.classes = class_of_diffuse | (class_of_glossy << 8u);
    shadow.left_instance = hit.instance;
    shadow.left_triangle = hit.triangle;
    shadows[slot] = shadow;
    let place = atomicAdd(&counters.next_shadow_count, 1u);
    queues[2u * pass_header.capacity + place] = slot;
}

fn scatter(slot: u32, path: ptr<function, Path>, hit: Hit, surface: Surface, sampler: PixelSampler) -> bool {
    let u = four(sampler, 1u + 2u * (*path).bounce);
    let wo = -(*path).direction;
    let wo_local = frame_to_local(surface.frame, wo);
    let drawn = sample_bsdf(surface.bsdf, wo_local, u.xyz);
    if !drawn.exists {
        return false;
    }
    let class_now = class_after((*path).class_so_far, drawn.is_specular);
    if !is_traced(class_now) && !are_traced_beyond(class_now) {
        return false;
    }
    let wi = frame_to_world(surface.frame, drawn.wi);
    (*path).throughput *= drawn.weight;
    (*path).eta_squared *= drawn.eta_squared;
    (*path).class_so_far = class_now;
    (*path).bounce += 1u;
    (*path).last_pdf = drawn.pdf_solid_angle;
    (*path).last_position = surface.point.position;
    (*path).last_n = select(surface.frame.n, -surface.frame.n, dot(wo, surface.frame.n) < 0.0);
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
        let survival = min(max_component((*path).throughput) * (*path).eta_squared, SURVIVAL_MAX);
        if u.w >= survival {
            return false;
        }
        (*path).throughput *= 1.0 / survival;
    }
    paths[slot] = *path;
    return true;
}
