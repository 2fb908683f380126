// Light from infinitely far that glass lets through as it came: `transport/panes.rs`.

const BOUNDARIES_MAX: u32 = 32u;
const STRAIGHT: f32 = 1e-3;
const SAME_INDEX: f32 = 1e-3;

struct Passage {
    /// The light arrives.
    exists: bool,
    boundaries: u32,
    /// Of the radiance that comes in.
    share: vec3f,
    /// Rays that it took to find out.
    rays: u32,
}

/// `World::through_panes`.
///
/// - `ray`: to the light, without end; its direction is a unit vector
fn through_panes(ray: Ray) -> Passage {
    var passage = Passage(false, 0u, vec3f(1.0), 0u);
    var ahead = ray;
    var eta_squared = 1.0;
    var medium = 0u;
    while passage.boundaries <= BOUNDARIES_MAX {
        passage.rays += 1u;
        let hit = closest_hit(ahead);
        if hit.instance == NO_INDEX {
            passage.exists = passage.boundaries > 0u && passage.boundaries <= BOUNDARIES_MAX
                && abs(eta_squared - 1.0) < SAME_INDEX
                && length_squared(ray.direction - ahead.direction) < STRAIGHT * STRAIGHT;
            return passage;
        }
        let surface = surface_at(hit.instance, hit.triangle, hit.b1, hit.b2, ahead.direction);
        if surface.bsdf.kind != GLASS {
            return passage;
        }
        if dot(ahead.direction, surface.frame.n) > 0.0 {
            medium = surface.inside;
        }
        let wo = -ahead.direction;
        let wo_local = frame_to_local(surface.frame, wo);
        let passing = glass_passing(surface.bsdf, wo_local);
        if !passing.exists || !(wo_local.z * passing.wi.z < 0.0) {
            return passage;
        }
        let wi = frame_to_world(surface.frame, passing.wi);
        passage.share *= transmittance(medium, hit.t) * passing.weight
            * (passing.eta_squared * flux_over_radiance(surface, wo, wi, passing));
        if !(luminance(passage.share) > 0.0 && max_component(passage.share) <= FLOAT_MAX) {
            return passage;
        }
        passage.boundaries += 1u;
        eta_squared *= passing.eta_squared;
        medium = select(0u, surface.inside, passing.wi.z < 0.0);
        ahead.origin = origin_towards(surface.point, wi);
        ahead.direction = wi;
        ahead.left_instance = hit.instance;
        ahead.left_triangle = hit.triangle;
    }
    return passage;
}
