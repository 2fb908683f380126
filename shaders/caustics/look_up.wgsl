// What photons of one pass bring of light that only mirrors and glass sent on before: `technique/caustics/map.rs`,
// `CausticMap::scattered`, of `technique/caustics/upload.rs`'s photons and words. Only where `HAS_FOCUSED`.

struct Photon {
    position: vec3f,
    /// Square of how far it is blurred, m².
    r2: f32,
    flux_w: vec3f,
    /// Before it fell here.
    scatterings: u32,
    /// Where it came from.
    direction: vec3f,
    padding_0: u32,
    /// Of the surface on the side it fell on.
    normal: vec3f,
    padding_1: u32,
}

@group(3) @binding(6) var<storage, read> photons: array<Photon>;
/// How many grids there are; `GRID_WORDS` of each; then where the entries of each bucket begin, and entries: numbers of photons.
@group(3) @binding(7) var<storage, read> photon_words: array<u32>;

const GRIDS_AT: u32 = 1u;
const GRID_WORDS: u32 = 9u;

/// `caustics/map.rs`.
const FLATNESS: f32 = 2.5;
const FACING_COS: f32 = 0.5;
const COS_RATIO_MIN: f32 = 0.02;

struct FocusedScatter {
    diffuse: vec3f,
    glossy: vec3f,
}

fn has_broad_gloss(bsdf: Bsdf) -> bool {
    return bsdf.kind == GLTF && bsdf.alpha >= BROAD_ALPHA;
}

/// First and end of the words that name the photons whose blurs may reach `p` in a grid.
fn photons_near(grid: u32, p: vec3f) -> vec2u {
    let at = GRIDS_AT + GRID_WORDS * grid;
    let low = vec3f(bitcast<f32>(photon_words[at]), bitcast<f32>(photon_words[at + 1u]), bitcast<f32>(photon_words[at + 2u]));
    let high =
        vec3f(bitcast<f32>(photon_words[at + 3u]), bitcast<f32>(photon_words[at + 4u]), bitcast<f32>(photon_words[at + 5u]));
    if any(p < low) || any(p > high) {
        return vec2u(0u);
    }
    let cell = vec3u(vec3i(floor((p - low) / bitcast<f32>(photon_words[at + 6u]))));
    let hash = (cell.x * 73856093u) ^ (cell.y * 19349663u) ^ (cell.z * 83492791u);
    let bucket = photon_words[at + 8u] + (hash & photon_words[at + 7u]);
    return vec2u(photon_words[bucket], photon_words[bucket + 1u]);
}

/// - `scatterings_max`: most scatterings before, of photons that count
fn focused_light(surface: Surface, wo: vec3f, scatterings_max: u32) -> FocusedScatter {
    var sum = FocusedScatter(vec3f(0.0), vec3f(0.0));
    let p = surface.point.position;
    let n_geo = surface.point.n_geo;
    let n = select(-n_geo, n_geo, dot(wo, n_geo) > 0.0);
    let wo_local = frame_to_local(surface.frame, wo);
    let is_broad = has_broad_gloss(surface.bsdf);
    for (var grid = 0u; grid < photon_words[0]; grid++) {
        let near = photons_near(grid, p);
        for (var name = near.x; name < near.y; name++) {
            let index = photon_words[name];
            let r2 = photons[index].r2;
            let away = p - photons[index].position;
            let away2 = length_squared(away);
            if !(away2 < r2) {
                continue;
            }
            let normal = photons[index].normal;
            let above = dot(away, normal);
            let d2 = away2 + (FLATNESS * FLATNESS - 1.0) * above * above;
            if !(d2 < r2) || photons[index].scatterings > scatterings_max || dot(normal, n) < FACING_COS {
                continue;
            }
            let wi = photons[index].direction;
            let shading_cos = dot(wi, surface.frame.n);
            let cosine = max(dot(wi, normal), COS_RATIO_MIN * abs(shading_cos));
            if !(cosine > 0.0) {
                continue;
            }
            let irradiance = photons[index].flux_w * (2.0 * INVERSE_PI / r2 * (1.0 - d2 / r2) / cosine);
            if surface.bsdf.kind == LAMBERT {
                if shading_cos * wo_local.z > 0.0 {
                    sum.diffuse += irradiance * abs(shading_cos);
                }
                continue;
            }
            let value = eval_bsdf(surface.bsdf, wo_local, frame_to_local(surface.frame, wi));
            sum.diffuse += value.diffuse.f_cos * irradiance;
            if is_broad {
                sum.glossy += value.glossy.f_cos * irradiance;
            }
        }
    }
    if surface.bsdf.kind == LAMBERT {
        sum.diffuse *= surface.bsdf.color * INVERSE_PI;
    }
    return sum;
}
