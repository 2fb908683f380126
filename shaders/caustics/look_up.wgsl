// What photons bring of light that only mirrors and glass sent on before: of one pass, in grids over the scene
// (`technique/caustics/map.rs`, of `technique/caustics/upload.rs`'s photons and words), or of a sketch, in cells of the picture
// (`technique/caustics/screen/mod.rs`). Only where `HAS_FOCUSED`.

@group(3) @binding(6) var<storage, read> photons: array<Photon>;
/// How many grids there are; `GRID_WORDS` of each; then where the entries of each bucket begin, and entries: numbers of photons.
/// Of a sketch see `sketch.wgsl`.
@group(3) @binding(7) var<storage, read> photon_words: array<u32>;
@group(3) @binding(8) var<uniform> sketch: Sketch;

const GRIDS_AT: u32 = 1u;
const GRID_WORDS: u32 = 9u;

/// `caustics/map.rs`.
const FLATNESS: f32 = 2.5;
const FACING_COS: f32 = 0.5;
const COS_RATIO_MIN: f32 = 0.02;
/// `caustics/screen/mod.rs`.
const COS_MIN: f32 = 0.1;
const ACROSS_MIN_M: f32 = 1e-18;
const CORNER_TO_CORNER: f32 = 1.4142135;

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

/// Share of a photon's flux that falls on every square metre at `p` by its blur; 0 beyond.
fn blurred_per_m2(index: u32, p: vec3f) -> f32 {
    let r2 = photons[index].r2;
    let away = p - photons[index].position;
    let away2 = length_squared(away);
    if !(away2 < r2) {
        return 0.0;
    }
    let above = dot(away, photons[index].normal);
    let d2 = away2 + (FLATNESS * FLATNESS - 1.0) * above * above;
    if !(d2 < r2) {
        return 0.0;
    }
    return 2.0 * INVERSE_PI / r2 * (1.0 - d2 / r2);
}

/// What a look-up in a sketch goes by.
struct SketchedPoint {
    pixel: vec2i,
    is_there: bool,
    /// Of the angle under which its surface is seen.
    cosine: f32,
    /// Width of a pixel there, m.
    pixel_m: f32,
}

/// `View::pixel_at`.
fn sketched_point(p: vec3f, n: vec3f) -> SketchedPoint {
    let seen = sketch_pixel(p, 0);
    let depth_m = max(dot(sketch.origin - p, sketch.back), 0.0);
    let across_m = 2.0 * sketch_half(sketch.half_width, depth_m) / f32(sketch.width);
    let down_m = 2.0 * sketch_half(sketch.half_height, depth_m) / f32(sketch.height);
    var area_m2 = across_m * down_m;
    var towards = sketch.back;
    if sketch.is_perspective != 0u {
        let to_eye = sketch.origin - p;
        let away2 = length_squared(to_eye);
        if away2 > 0.0 {
            towards = to_eye / sqrt(away2);
        }
        area_m2 *= max(dot(towards, sketch.back), 0.0);
    }
    return SketchedPoint(seen.at, seen.is_there, abs(dot(towards, n)), sqrt(area_m2));
}

/// Photons with windows of one width whose windows may hold a point.
struct Near {
    /// Words that name them.
    first: u32,
    end: u32,
    /// What lies farther above or below, or along the surface, is another sheet.
    above_end_m: f32,
    along_end2_m2: f32,
    per_m2: f32,
    half_px: i32,
    weights_at: u32,
}

fn sketched_near(point: SketchedPoint, windows: Windows) -> Near {
    var near: Near;
    if !point.is_there {
        return near;
    }
    let cell = vec2u(point.pixel >> vec2u(windows.cell_log2));
    let at = windows.cells_at + SKETCH_CELL_WORDS * (cell.y * windows.columns + cell.x);
    let across_m = f32(2 * windows.half_px + 1) * point.pixel_m;
    if photon_words[at] == 0u || !(across_m > ACROSS_MIN_M) {
        return near;
    }
    near.end = photon_words[at + 1u];
    near.first = near.end - photon_words[at];
    near.above_end_m = f32(windows.half_px + 1) * point.pixel_m / FLATNESS;
    let along_end_m = CORNER_TO_CORNER * across_m / max(point.cosine, COS_MIN);
    near.along_end2_m2 = along_end_m * along_end_m;
    // Of a window that is longer, what is twice as long as that.
    near.per_m2 = max(point.cosine / across_m, 0.5 / along_end_m) / across_m;
    near.half_px = windows.half_px;
    near.weights_at = windows.weights_at;
    return near;
}

/// Share of a photon's flux that falls on every square metre at a point by its window; 0 beyond, and where it lies on another sheet.
fn windowed_per_m2(index: u32, near: Near, pixel: vec2i, p: vec3f, n: vec3f) -> f32 {
    let at = sketch.places_at + SKETCH_PLACE_WORDS * index;
    let place = vec2i(bitcast<i32>(photon_words[at]), bitcast<i32>(photon_words[at + 1u]));
    let apart = abs(place - pixel);
    if max(apart.x, apart.y) > near.half_px {
        return 0.0;
    }
    let away = photons[index].position - p;
    if !(abs(dot(away, n)) < near.above_end_m && length_squared(away) < near.along_end2_m2) {
        return 0.0;
    }
    return bitcast<f32>(photon_words[near.weights_at + u32(apart.y * (near.half_px + 1) + apart.x)]) * near.per_m2;
}

/// `Lit`: what a surface sends on of the photons that light it.
///
/// - `scatterings_max`: most scatterings before, of photons that count
fn focused_light(surface: Surface, wo: vec3f, scatterings_max: u32) -> FocusedScatter {
    var sum = FocusedScatter(vec3f(0.0), vec3f(0.0));
    let p = surface.point.position;
    let n_geo = surface.point.n_geo;
    let n = select(-n_geo, n_geo, dot(wo, n_geo) > 0.0);
    let wo_local = frame_to_local(surface.frame, wo);
    let is_broad = has_broad_gloss(surface.bsdf);
    let is_sketch = sketch.width_count > 0u;
    var point: SketchedPoint;
    if is_sketch {
        point = sketched_point(p, n_geo);
    }
    // Grids of a pass, or widths of windows.
    let part_count = select(photon_words[0], sketch.width_count, is_sketch);
    for (var part = 0u; part < part_count; part++) {
        var near: Near;
        if is_sketch {
            near = sketched_near(point, sketch.windows[part]);
        } else {
            let names = photons_near(part, p);
            near.first = names.x;
            near.end = names.y;
        }
        for (var name = near.first; name < near.end; name++) {
            let index = photon_words[name];
            var per_m2 = 0.0;
            if is_sketch {
                per_m2 = windowed_per_m2(index, near, point.pixel, p, n_geo);
            } else {
                per_m2 = blurred_per_m2(index, p);
            }
            let normal = photons[index].normal;
            if !(per_m2 > 0.0) || photons[index].scatterings > scatterings_max || dot(normal, n) < FACING_COS {
                continue;
            }
            let wi = photons[index].direction;
            let shading_cos = dot(wi, surface.frame.n);
            let cosine = max(dot(wi, normal), COS_RATIO_MIN * abs(shading_cos));
            if !(cosine > 0.0) {
                continue;
            }
            let irradiance = photons[index].flux_w * (per_m2 / cosine);
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
