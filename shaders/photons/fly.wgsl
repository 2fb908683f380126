// Takes each photon to the surface that its ray met: what it leaves behind there, and where it goes on. `photons/trace.rs`,
// `PhotonTracer::advance`, and `transport/flight.rs`.

@compute @workgroup_size(WORKGROUP)
fn fly(@builtin(global_invocation_id) id: vec3u) {
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
    let name = (slot << BOUNCE_BITS) | path.bounce;
    if hit.instance == NO_INDEX {
        keep(KeptPhoton(0.0, 0.0, 0u, ESCAPED, path.throughput, 0.0, path.direction, name));
        return false;
    }
    let direction = path.direction;
    let surface = surface_at(hit.instance, hit.triangle, hit.b1, hit.b2, direction);
    if HAS_GLASS && surface.bsdf.kind == GLASS && dot(direction, surface.frame.n) > 0.0 {
        path.medium = surface.inside;
    }
    path.throughput *= transmittance(path.medium, hit.t);
    let arrived = path.throughput;
    var place = (hit.instance << MARK_BITS) | path.class_so_far;
    place |= select(0u, MARK_FRONT, dot(-direction, surface.point.n_geo) > 0.0);
    place |= select(0u, MARK_DIFFUSE, has_diffuse(surface.bsdf));
    let goes_on = luminance(arrived) > 0.0 && scatter(&path, hit, surface);
    let leaving = select(0.0, luminance(path.throughput), goes_on);
    keep(KeptPhoton(hit.b1, hit.b2, hit.triangle, place, arrived, leaving, direction, name));
    if !goes_on || path.bounce >= pass_header.bounces_end {
        return false;
    }
    paths[slot] = path;
    return true;
}

/// `Flight::draw`.
fn draw(path: Path, surface: ptr<function, Surface>, u: vec3f) -> BsdfSample {
    let wo = -path.direction;
    let bsdf = (*surface).bsdf;
    var drawn = sample_bsdf(bsdf, frame_to_local((*surface).frame, wo), u);
    if !drawn.exists {
        return drawn;
    }
    let n_geo = (*surface).point.n_geo;
    let normals = (*surface).normals;
    if drawn.is_specular {
        // `Surface::reflects_photons_of`.
        let reflects = bsdf.kind == GLASS || face_alike(normals, wo);
        if !reflects || !may_scatter(*surface, wo, frame_to_world((*surface).frame, drawn.wi)) {
            return absorbed();
        }
        return drawn;
    }
    if face_alike(normals, wo) && abs(dot(normals.n_mapped, n_geo)) >= STRAIGHT_COS {
        return drawn;
    }
    var wi = frame_to_world(frame_around(n_geo), cosine_hemisphere(u.yz));
    if dot(wi, normals.n_side) * dot(wo, normals.n_side) < 0.0 {
        wi = -wi;
    }
    let chance = drawn.pdf_solid_angle / cosine_hemisphere_pdf(abs(drawn.wi.z));
    let frame = frame_around(seen_from(normals, wi));
    let pdf = chance * cosine_hemisphere_pdf(abs(dot(wi, n_geo)));
    if !(pdf > 0.0) {
        return absorbed();
    }
    (*surface).frame = frame;
    drawn.wi = frame_to_local(frame, wi);
    drawn.weight = eval_bsdf(bsdf, frame_to_local(frame, wo), drawn.wi).diffuse.f_cos * (1.0 / pdf);
    drawn.pdf_solid_angle = pdf;
    return drawn;
}

/// Draws where the photon goes on; false when it is absorbed.
fn scatter(path: ptr<function, Path>, hit: Hit, met: Surface) -> bool {
    let u = four(PixelSampler((*path).key, (*path).passing), (*path).bounce + 2u);
    var surface = met;
    let drawn = draw(*path, &surface, u.xyz);
    if !drawn.exists {
        return false;
    }
    // `Flight::scattered`.
    let wo = -(*path).direction;
    let wo_local = frame_to_local(surface.frame, wo);
    let wi = frame_to_world(surface.frame, drawn.wi);
    let weight = (*path).throughput * drawn.weight
        * (drawn.eta_squared * flux_over_radiance(surface, wo, wi, drawn));
    let carried = luminance(weight);
    if !(carried > 0.0 && max_component(weight) <= FLOAT_MAX) {
        return false;
    }
    let survives = min(carried / luminance((*path).throughput), PHOTON_SURVIVAL_MAX);
    if !(survives > 0.0) || u.w >= survives {
        return false;
    }
    if HAS_GLASS && wo_local.z * drawn.wi.z < 0.0 {
        (*path).medium = select(0u, surface.inside, drawn.wi.z < 0.0);
    }
    (*path).throughput = weight * (1.0 / survives);
    let is_focused = drawn.is_specular && (*path).class_so_far != INDIRECT;
    (*path).class_so_far = select(INDIRECT, CAUSTIC, is_focused);
    (*path).bounce += 1u;
    (*path).origin = origin_towards(surface.point, wi);
    (*path).direction = wi;
    (*path).left_instance = hit.instance;
    (*path).left_triangle = hit.triangle;
    return true;
}
