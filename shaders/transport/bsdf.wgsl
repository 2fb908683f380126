// How a surface scatters light: the models of `transport/bsdf`, lobe by lobe, in the shading frame.

const BLACK: u32 = 0u;
const LAMBERT: u32 = 1u;
const GLTF: u32 = 2u;
const MIRROR: u32 = 3u;
const GLASS: u32 = 4u;

struct Bsdf {
    kind: u32,
    /// Albedo, reflectance, tint, or that of glTF's base.
    color: vec3f,
    metallic: f32,
    dielectric_f0: vec3f,
    dielectric_f90: f32,
    metal_f0: vec3f,
    alpha: f32,
    eta: f32,
    transmission: f32,
}

struct LobeValue {
    f_cos: vec3f,
    pdf_solid_angle: f32,
}

struct BsdfValue {
    diffuse: LobeValue,
    glossy: LobeValue,
}

struct BsdfSample {
    /// The light is not absorbed.
    exists: bool,
    is_specular: bool,
    wi: vec3f,
    weight: vec3f,
    /// Below 0: a mirror or glass direction, which has none.
    pdf_solid_angle: f32,
    eta_squared: f32,
}

const NO_DENSITY: f32 = -1.0;

fn absorbed() -> BsdfSample {
    return BsdfSample(false, false, vec3f(0.0), vec3f(0.0), NO_DENSITY, 1.0);
}

fn dark() -> LobeValue {
    return LobeValue(vec3f(0.0), 0.0);
}

fn lambert(albedo: vec3f, wi: vec3f, chance: f32) -> LobeValue {
    let cosine = abs(wi.z);
    return LobeValue(albedo * (INVERSE_PI * cosine), cosine_hemisphere_pdf(cosine) * chance);
}

fn sample_lambert(albedo: vec3f, wo: vec3f, u: vec2f) -> BsdfSample {
    var wi = cosine_hemisphere(u);
    let pdf = cosine_hemisphere_pdf(wi.z);
    if pdf <= 0.0 {
        return absorbed();
    }
    wi.z = copysign(wi.z, wo.z);
    return BsdfSample(true, false, wi, albedo, pdf, 1.0);
}

// GGX with height-correlated Smith masking [Walter2007, Heitz2014].

fn ggx_d(alpha: f32, m: vec3f) -> f32 {
    if m.z <= 0.0 {
        return 0.0;
    }
    let a2 = alpha * alpha;
    let t = (m.x * m.x + m.y * m.y) / a2 + m.z * m.z;
    return 1.0 / (PI * a2 * t * t);
}

/// For w.z other than 0.
fn ggx_lambda(alpha: f32, w: vec3f) -> f32 {
    let tan2 = (w.x * w.x + w.y * w.y) / max(w.z * w.z, 1e-30);
    return 0.5 * (sqrt(1.0 + alpha * alpha * tan2) - 1.0);
}

fn ggx_g1(alpha: f32, w: vec3f) -> f32 {
    return 1.0 / (1.0 + ggx_lambda(alpha, w));
}

fn ggx_g2(alpha: f32, wo: vec3f, wi: vec3f) -> f32 {
    return 1.0 / (1.0 + ggx_lambda(alpha, wo) + ggx_lambda(alpha, wi));
}

fn ggx_visible_pdf(alpha: f32, wo: vec3f, m: vec3f) -> f32 {
    return ggx_g1(alpha, wo) * max(dot(wo, m), 0.0) * ggx_d(alpha, m) / wo.z;
}

/// [Dupuy2023]
fn ggx_sample_visible(alpha: f32, wo: vec3f, u: vec2f) -> vec3f {
    let stretched = normalize(vec3f(wo.x * alpha, wo.y * alpha, wo.z));
    let phi = TAU * u.x;
    let z = (1.0 - u.y) * (1.0 + stretched.z) - stretched.z;
    let r = sqrt(max(1.0 - z * z, 0.0));
    let half = vec3f(r * cos(phi), r * sin(phi), z) + stretched;
    return normalize_or(vec3f(half.x * alpha, half.y * alpha, max(half.z, 0.0)), vec3f(0.0, 0.0, 1.0));
}

// glTF's metallic-roughness: `transport/bsdf/gltf.rs`.

fn schlick_rise(cosine: f32) -> f32 {
    let rest = 1.0 - clamp(cosine, 0.0, 1.0);
    let square = rest * rest;
    return square * square * rest;
}

fn gltf_dielectric(bsdf: Bsdf, cosine: f32) -> vec3f {
    let f0 = bsdf.dielectric_f0;
    return f0 + max(bsdf.dielectric_f90 - f0, vec3f(0.0)) * schlick_rise(cosine);
}

fn gltf_reflected(bsdf: Bsdf, cosine: f32) -> vec3f {
    let metal = bsdf.metal_f0 + (1.0 - bsdf.metal_f0) * schlick_rise(cosine);
    return gltf_dielectric(bsdf, cosine) * (1.0 - bsdf.metallic) + metal * bsdf.metallic;
}

fn gltf_passing(bsdf: Bsdf, cosine: f32) -> f32 {
    return 1.0 - max_component(gltf_dielectric(bsdf, cosine));
}

fn gltf_passing_mean(bsdf: Bsdf) -> f32 {
    let f0 = max_component(bsdf.dielectric_f0);
    return max(1.0 - f0 - max(bsdf.dielectric_f90 - f0, 0.0) / 21.0, 1e-6);
}

/// `transport/bsdf/base.rs`: f = scale · (1 − rise · (1 − cos θᵢ)⁵) of a diffuse lobe towards one direction.
struct CoatedBase {
    scale: vec3f,
    rise: f32,
}

fn passing(base: CoatedBase, cosine: f32) -> f32 {
    return 1.0 - base.rise * schlick_rise(cosine);
}

fn gltf_coated_base(bsdf: Bsdf, wo: vec3f) -> CoatedBase {
    let f0 = max_component(bsdf.dielectric_f0);
    let ahead = 1.0 - f0;
    if !(ahead > 0.0) {
        return CoatedBase(vec3f(0.0), 0.0);
    }
    let share = gltf_passing(bsdf, abs(wo.z)) * ahead / gltf_passing_mean(bsdf);
    return CoatedBase(bsdf.color * (share * INVERSE_PI), max(bsdf.dielectric_f90 - f0, 0.0) / ahead);
}

fn gltf_base(bsdf: Bsdf, wo: vec3f, wi: vec3f, chance: f32) -> LobeValue {
    let base = gltf_coated_base(bsdf, wo);
    let cosine = abs(wi.z);
    return LobeValue(base.scale * (passing(base, cosine) * cosine), cosine_hemisphere_pdf(cosine) * chance);
}

fn gltf_specular_chance(bsdf: Bsdf, wo: vec3f) -> f32 {
    let specular = luminance(gltf_reflected(bsdf, abs(wo.z)));
    let diffuse = luminance(bsdf.color) * gltf_passing(bsdf, abs(wo.z));
    if diffuse <= 0.0 {
        return 1.0;
    }
    if specular <= 0.0 {
        return 0.0;
    }
    return clamp(specular / (specular + diffuse), 0.1, 0.9);
}

fn gltf_is_smooth(bsdf: Bsdf) -> bool {
    return bsdf.alpha < SMOOTH_ALPHA;
}

fn gltf_eval(bsdf: Bsdf, wo_of_side: vec3f, wi_of_side: vec3f) -> BsdfValue {
    let wo = vec3f(wo_of_side.xy, abs(wo_of_side.z));
    let wi = vec3f(wi_of_side.xy, abs(wi_of_side.z));
    let chance = gltf_specular_chance(bsdf, wo);
    let diffuse = gltf_base(bsdf, wo, wi, 1.0 - chance);
    let sum = wo + wi;
    if gltf_is_smooth(bsdf) || !(length_squared(sum) > 1e-30) {
        return BsdfValue(diffuse, dark());
    }
    let m = normalize(sum);
    let f_cos = gltf_reflected(bsdf, dot(wo, m)) * (ggx_d(bsdf.alpha, m) * ggx_g2(bsdf.alpha, wo, wi) / (4.0 * wo.z));
    let pdf = ggx_visible_pdf(bsdf.alpha, wo, m) / (4.0 * dot(wo, m));
    return BsdfValue(diffuse, LobeValue(f_cos, pdf * chance));
}

fn gltf_sample(bsdf: Bsdf, wo_of_side: vec3f, u: vec3f) -> BsdfSample {
    let side = copysign(1.0, wo_of_side.z);
    let wo = vec3f(wo_of_side.xy, wo_of_side.z * side);
    if wo.z <= 0.0 {
        return absorbed();
    }
    let chance = gltf_specular_chance(bsdf, wo);
    if u.x >= chance {
        let wi = cosine_hemisphere(u.yz);
        let value = gltf_base(bsdf, wo, wi, 1.0 - chance);
        if !(value.pdf_solid_angle > 0.0) {
            return absorbed();
        }
        let weight = value.f_cos * (1.0 / value.pdf_solid_angle);
        return BsdfSample(true, false, vec3f(wi.xy, wi.z * side), weight, value.pdf_solid_angle, 1.0);
    }
    if gltf_is_smooth(bsdf) {
        let weight = gltf_reflected(bsdf, wo.z) * (1.0 / chance);
        return BsdfSample(true, true, vec3f(-wo.xy, wo.z * side), weight, NO_DENSITY, 1.0);
    }
    let m = ggx_sample_visible(bsdf.alpha, wo, u.yz);
    let wi = m * (2.0 * dot(wo, m)) - wo;
    let pdf = ggx_visible_pdf(bsdf.alpha, wo, m) / (4.0 * dot(wo, m));
    if wi.z <= 0.0 || !(pdf > 0.0) {
        return absorbed();
    }
    let weight = gltf_reflected(bsdf, dot(wo, m))
        * (ggx_g2(bsdf.alpha, wo, wi) / (ggx_g1(bsdf.alpha, wo) * chance));
    return BsdfSample(true, true, vec3f(wi.xy, wi.z * side), weight, pdf * chance, 1.0);
}

// A smooth boundary: `transport/bsdf/glass.rs`.

/// x: share reflected; y: cosine on the other side, 0 where reflection is total.
fn fresnel_dielectric(cos_incoming: f32, eta: f32) -> vec2f {
    let cos_i = clamp(cos_incoming, 0.0, 1.0);
    if eta == 1.0 {
        return vec2f(0.0, cos_i);
    }
    let sin2_t = (1.0 - cos_i * cos_i) / (eta * eta);
    if sin2_t >= 1.0 {
        return vec2f(1.0, 0.0);
    }
    let cos_t = sqrt(1.0 - sin2_t);
    let parallel = (eta * cos_i - cos_t) / (eta * cos_i + cos_t);
    let perpendicular = (cos_i - eta * cos_t) / (cos_i + eta * cos_t);
    return vec2f(0.5 * (parallel * parallel + perpendicular * perpendicular), cos_t);
}

fn glass_eta_from(bsdf: Bsdf, wo: vec3f) -> f32 {
    return select(1.0 / bsdf.eta, bsdf.eta, wo.z > 0.0);
}

/// Share of evenly arriving light that passes a smooth boundary: 32 midpoints in μ².
fn glass_passing_mean(eta: f32) -> f32 {
    let first = max(1.0 - eta * eta, 0.0);
    var sum = 0.0;
    for (var i = 0u; i < 32u; i++) {
        let mu2 = first + (1.0 - first) * (f32(i) + 0.5) / 32.0;
        sum += 1.0 - fresnel_dielectric(sqrt(mu2), eta).x;
    }
    return max(sum / 32.0 * (1.0 - first), 1e-6);
}

fn glass_base(bsdf: Bsdf, reflected: f32, wi: vec3f, eta: f32, chance: f32) -> LobeValue {
    let reflected_in = fresnel_dielectric(abs(wi.z), eta).x;
    let share = (1.0 - reflected) * (1.0 - bsdf.transmission) * (1.0 - reflected_in) / glass_passing_mean(eta);
    return lambert(bsdf.color * share, wi, chance);
}

fn glass_eval(bsdf: Bsdf, wo: vec3f, wi: vec3f) -> BsdfValue {
    let eta = glass_eta_from(bsdf, wo);
    let reflected = fresnel_dielectric(abs(wo.z), eta).x;
    let chance = (1.0 - reflected) * (1.0 - bsdf.transmission);
    return BsdfValue(glass_base(bsdf, reflected, wi, eta, chance), dark());
}

fn glass_sample(bsdf: Bsdf, wo: vec3f, u: vec3f) -> BsdfSample {
    let eta = glass_eta_from(bsdf, wo);
    let boundary = fresnel_dielectric(abs(wo.z), eta);
    let reflected = boundary.x;
    if u.x < reflected {
        return BsdfSample(true, true, vec3f(-wo.xy, wo.z), vec3f(1.0), NO_DENSITY, 1.0);
    }
    if u.x < reflected + (1.0 - reflected) * bsdf.transmission {
        return glass_passed(bsdf, wo, eta, boundary.y);
    }
    var wi = cosine_hemisphere(u.yz);
    wi.z = copysign(wi.z, wo.z);
    let value = glass_base(bsdf, reflected, wi, eta, (1.0 - reflected) * (1.0 - bsdf.transmission));
    if !(value.pdf_solid_angle > 0.0) {
        return absorbed();
    }
    let weight = value.f_cos * (1.0 / value.pdf_solid_angle);
    return BsdfSample(true, false, wi, weight, value.pdf_solid_angle, 1.0);
}

/// All that passes, undrawn: `Glass::passing`.
fn glass_passing(bsdf: Bsdf, wo: vec3f) -> BsdfSample {
    let eta = glass_eta_from(bsdf, wo);
    let boundary = fresnel_dielectric(abs(wo.z), eta);
    let transmission = (1.0 - boundary.x) * bsdf.transmission;
    if !(transmission > 0.0) {
        return absorbed();
    }
    var passed = glass_passed(bsdf, wo, eta, boundary.y);
    passed.weight *= transmission;
    return passed;
}

fn glass_passed(bsdf: Bsdf, wo: vec3f, eta: f32, cos_t: f32) -> BsdfSample {
    let wi = normalize_or(vec3f(-wo.xy / eta, -copysign(cos_t, wo.z)), -wo);
    return BsdfSample(true, true, wi, bsdf.color * (1.0 / (eta * eta)), NO_DENSITY, eta * eta);
}

// All of them.

fn has_density(bsdf: Bsdf) -> bool {
    switch bsdf.kind {
        case LAMBERT: {
            return true;
        }
        case GLTF: {
            return !gltf_is_smooth(bsdf) || !is_black(bsdf.color);
        }
        case GLASS: {
            return bsdf.transmission < 1.0 && !is_black(bsdf.color);
        }
        default: {
            return false;
        }
    }
}

/// It scatters nothing but what it mirrors and what lies behind it.
fn is_clear(bsdf: Bsdf) -> bool {
    return bsdf.kind != BLACK && !has_density(bsdf);
}

/// Most of what a clear surface shows comes from the side of `wi`.
fn shows_most_from(bsdf: Bsdf, wo: vec3f, wi: vec3f) -> bool {
    if bsdf.kind != GLASS {
        return true;
    }
    let reflected = fresnel_dielectric(abs(wo.z), glass_eta_from(bsdf, wo)).x;
    let passes_through = wo.z * wi.z < 0.0;
    return passes_through == (reflected <= 0.5);
}

fn has_diffuse(bsdf: Bsdf) -> bool {
    return bsdf.kind == LAMBERT || bsdf.kind == GLTF && !is_black(bsdf.color) || bsdf.kind == GLASS && has_density(bsdf);
}

/// Share of light from straight ahead that is scattered.
fn albedo_of(bsdf: Bsdf) -> vec3f {
    switch bsdf.kind {
        case LAMBERT, MIRROR: {
            return bsdf.color;
        }
        case GLTF: {
            return bsdf.color * gltf_passing(bsdf, 1.0) + gltf_reflected(bsdf, 1.0);
        }
        case GLASS: {
            let reflected = fresnel_dielectric(1.0, bsdf.eta).x;
            return vec3f(reflected) + bsdf.color * (1.0 - reflected);
        }
        default: {
            return vec3f(0.0);
        }
    }
}

/// What the diffuse lobe sends to `wo` of light of irradiance one.
///
/// - `rise`: mean of `schlick_rise` over it
fn diffuse_of_light(bsdf: Bsdf, wo: vec3f, rise: f32) -> vec3f {
    if bsdf.kind == LAMBERT {
        return bsdf.color * INVERSE_PI;
    }
    if HAS_GLTF && bsdf.kind == GLTF && wo.z > 0.0 {
        let base = gltf_coated_base(bsdf, wo);
        return base.scale * (1.0 - base.rise * rise);
    }
    // Takes any light for even.
    if HAS_GLASS && bsdf.kind == GLASS {
        let reflected = fresnel_dielectric(abs(wo.z), glass_eta_from(bsdf, wo)).x;
        return bsdf.color * ((1.0 - reflected) * (1.0 - bsdf.transmission) * INVERSE_PI);
    }
    return vec3f(0.0);
}

/// The diffuse lobe towards `wo`, where it is a Lambert lobe or one under glTF's coat: see `has_coated_base`.
fn coated_base(bsdf: Bsdf, wo: vec3f) -> CoatedBase {
    if HAS_GLTF && bsdf.kind == GLTF {
        return gltf_coated_base(bsdf, wo);
    }
    return CoatedBase(bsdf.color * INVERSE_PI, 0.0);
}

fn has_coated_base(bsdf: Bsdf) -> bool {
    return bsdf.kind == LAMBERT || bsdf.kind == GLTF;
}

fn eval_bsdf(bsdf: Bsdf, wo: vec3f, wi: vec3f) -> BsdfValue {
    if wo.z * wi.z <= 0.0 {
        return BsdfValue(dark(), dark());
    }
    if bsdf.kind == LAMBERT {
        return BsdfValue(lambert(bsdf.color, wi, 1.0), dark());
    }
    if HAS_GLTF && bsdf.kind == GLTF {
        return gltf_eval(bsdf, wo, wi);
    }
    if HAS_GLASS && bsdf.kind == GLASS {
        return glass_eval(bsdf, wo, wi);
    }
    return BsdfValue(dark(), dark());
}

fn sample_bsdf(bsdf: Bsdf, wo: vec3f, u: vec3f) -> BsdfSample {
    if bsdf.kind == LAMBERT {
        return sample_lambert(bsdf.color, wo, u.yz);
    }
    if bsdf.kind == MIRROR {
        return BsdfSample(true, true, vec3f(-wo.xy, wo.z), bsdf.color, NO_DENSITY, 1.0);
    }
    if HAS_GLTF && bsdf.kind == GLTF {
        return gltf_sample(bsdf, wo, u);
    }
    if HAS_GLASS && bsdf.kind == GLASS {
        return glass_sample(bsdf, wo, u);
    }
    return absorbed();
}
