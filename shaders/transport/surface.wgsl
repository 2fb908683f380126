// A point of a surface as a path meets it: `transport/surface.rs`.

/// The normal that says which side is seen, and the one bent by the normal map: `Normals`.
struct Normals {
    n_side: vec3f,
    n_mapped: vec3f,
}

struct Surface {
    point: SurfacePoint,
    frame: Frame,
    normals: Normals,
    bsdf: Bsdf,
    /// Radiance sent back along the ray.
    emitted: vec3f,
    /// Radiance that only counts where the surface is seen.
    unlit: vec3f,
    /// The material whose inside absorbs, plus one; 0 for none.
    inside: u32,
}

fn emitted(instance: u32, triangle: u32, material: u32, weights: vec3f, from_front: bool) -> vec3f {
    let flags = materials[material].flags;
    let emission = materials[material].emission;
    if (flags & UNLIT) != 0u || is_black(emission) || !(from_front || (flags & TWO_SIDED) != 0u) {
        return vec3f(0.0);
    }
    if !HAS_TEXTURES || (materials[material].textures[EMISSION].flags & TEXTURE_IS_THERE) == 0u {
        return emission;
    }
    let at = interpolated(instance, corners_of(instance, triangle), weights);
    return emission * sampled(material, EMISSION, at, vec4f(1.0)).xyz;
}

fn bsdf_of(material: u32, base: vec3f, at: Interpolated) -> Bsdf {
    var bsdf = Bsdf(BLACK, base, 0.0, vec3f(0.0), 0.0, vec3f(0.0), 1.0, 1.0, 0.0);
    let roughness_metallic = sampled(material, METALLIC_ROUGHNESS, at, vec4f(1.0));
    let roughness = materials[material].roughness * roughness_metallic.y;
    let metallic = materials[material].metallic * roughness_metallic.z;
    let specular = materials[material].specular * sampled(material, SPECULAR, at, vec4f(1.0)).w;
    let transmission = materials[material].transmission * sampled(material, TRANSMISSION, at, vec4f(1.0)).x;
    if HAS_GLASS && transmission > 0.0 && metallic < 1.0 {
        bsdf.kind = GLASS;
        bsdf.eta = materials[material].ior;
        bsdf.transmission = transmission;
        return bsdf;
    }
    if metallic >= 1.0 && roughness * roughness < SMOOTH_ALPHA {
        bsdf.kind = MIRROR;
        return bsdf;
    }
    if metallic <= 0.0 && specular <= 0.0 {
        bsdf.kind = select(LAMBERT, BLACK, is_black(base));
        return bsdf;
    }
    let tint = materials[material].specular_color * sampled(material, SPECULAR_COLOR, at, vec4f(1.0)).xyz;
    let ior = materials[material].ior;
    let root = (ior - 1.0) / (ior + 1.0);
    bsdf.kind = GLTF;
    bsdf.color = base * (1.0 - metallic);
    bsdf.metallic = metallic;
    bsdf.dielectric_f0 = min(tint * (root * root), vec3f(1.0)) * specular;
    bsdf.dielectric_f90 = specular;
    bsdf.metal_f0 = base;
    bsdf.alpha = roughness * roughness;
    return bsdf;
}

/// `Normals::face_alike`.
fn face_alike(normals: Normals, wo: vec3f) -> bool {
    return dot(wo, normals.n_mapped) * dot(wo, normals.n_side) >= 0.0;
}

/// `Normals::seen_from`.
fn seen_from(normals: Normals, wo: vec3f) -> vec3f {
    if face_alike(normals, wo) {
        return normals.n_mapped;
    }
    return normals.n_mapped - wo * (2.0 * dot(wo, normals.n_mapped));
}

/// `Surface::may_scatter`.
fn may_scatter(surface: Surface, wo: vec3f, wi: vec3f) -> bool {
    return surface.bsdf.kind == GLASS || dot(wo, surface.normals.n_side) * dot(wi, surface.normals.n_side) > 0.0;
}

/// The interpolated normal; the triangle's own where the mesh has none.
fn smooth_normal(instance: u32, corners: vec3u, weights: vec3f, n_geo: vec3f) -> vec3f {
    let normals_at = placements[instance].normals_at;
    if normals_at == ABSENT {
        return n_geo;
    }
    let a = geometry_vec3(normals_at, corners.x);
    let b = geometry_vec3(normals_at, corners.y);
    let c = geometry_vec3(normals_at, corners.z);
    if is_black(a) || is_black(b) || is_black(c) {
        return n_geo;
    }
    return normalize_or(normal_to_render(instance, a * weights.x + b * weights.y + c * weights.z), n_geo);
}

/// `PreparedMaterial::normals`; `n` is the interpolated one.
fn bent_normals(
    instance: u32,
    corners: vec3u,
    weights: vec3f,
    material: u32,
    at: Interpolated,
    n: vec3f,
    n_geo: vec3f,
) -> Normals {
    if !HAS_TEXTURES || (materials[material].textures[NORMAL].flags & TEXTURE_IS_THERE) == 0u {
        return Normals(n, n);
    }
    let texel = sampled(material, NORMAL, at, vec4f(0.5, 0.5, 1.0, 1.0));
    let scale = materials[material].normal_scale;
    let bend = vec3f((texel.xy * 2.0 - 1.0) * scale, texel.z * 2.0 - 1.0);
    var tangent = vec3f(0.0);
    var handedness = 1.0;
    let tangents_at = placements[instance].tangents_at;
    if tangents_at != ABSENT {
        let first = geometry_vec4(tangents_at, corners.x);
        tangent = first.xyz * weights.x + geometry_vec4(tangents_at, corners.y).xyz * weights.y
            + geometry_vec4(tangents_at, corners.z).xyz * weights.z;
        handedness = select(1.0, -1.0, first.w < 0.0);
    } else {
        let is_second_set = (materials[material].textures[NORMAL].flags & TEXTURE_SECOND_SET) != 0u;
        let texcoords_at = select(placements[instance].texcoords_0_at, placements[instance].texcoords_1_at, is_second_set);
        if texcoords_at == ABSENT {
            return Normals(n, n);
        }
        let positions_at = placements[instance].positions_at;
        let p0 = geometry_vec3(positions_at, corners.x);
        let e1 = geometry_vec3(positions_at, corners.y) - p0;
        let e2 = geometry_vec3(positions_at, corners.z) - p0;
        let t0 = geometry_vec2(texcoords_at, corners.x);
        let d1 = geometry_vec2(texcoords_at, corners.y) - t0;
        let d2 = geometry_vec2(texcoords_at, corners.z) - t0;
        let determinant = d1.x * d2.y - d1.y * d2.x;
        if determinant == 0.0 {
            return Normals(n, n);
        }
        // glTF's v runs down the picture, a normal map's green up: hence the sign of the bitangent.
        tangent = (e1 * d2.y - e2 * d1.y) * copysign(1.0, determinant);
        handedness = -copysign(1.0, determinant);
    }
    let turned = to_render(instance, tangent);
    let t = normalize_or(turned - n * dot(n, turned), vec3f(0.0));
    if is_black(t) {
        return Normals(n, n);
    }
    let mirrored = select(1.0, -1.0, (placements[instance].flags & MIRRORED) != 0u);
    let b = cross(n, t) * handedness * mirrored;
    let bent = t * bend.x + b * bend.y + n * bend.z;
    let mapped = normalize_or(bent, vec3f(0.0));
    if is_black(mapped) {
        return Normals(n, n);
    }
    return Normals(select(n_geo, -n_geo, dot(n, n_geo) < 0.0), mapped);
}

/// The surface at a hit, met along the unit direction `direction`.
fn surface_at(instance: u32, triangle: u32, b1: f32, b2: f32, direction: vec3f) -> Surface {
    var surface: Surface;
    surface.point = surface_point(instance, triangle, b1, b2);
    let corners = corners_of(instance, triangle);
    let weights = vec3f(1.0 - b1 - b2, b1, b2);
    let material = material_of(instance, triangle);
    let at = interpolated(instance, corners, weights);
    let wo = -direction;
    surface.emitted = emitted(instance, triangle, material, weights, dot(wo, surface.point.n_geo) > 0.0);
    let texel = sampled(material, BASE_COLOR, at, vec4f(1.0)) * at.color;
    let base = materials[material].base_color * texel.xyz;
    let n_smooth = smooth_normal(instance, corners, weights, surface.point.n_geo);
    var normals = bent_normals(instance, corners, weights, material, at, n_smooth, surface.point.n_geo);
    surface.unlit = vec3f(0.0);
    surface.inside = 0u;
    if (materials[material].flags & UNLIT) != 0u {
        surface.normals = normals;
        surface.frame = frame_around(normals.n_mapped);
        surface.bsdf = Bsdf(BLACK, vec3f(0.0), 0.0, vec3f(0.0), 0.0, vec3f(0.0), 1.0, 1.0, 0.0);
        surface.emitted = vec3f(0.0);
        surface.unlit = base;
        return surface;
    }
    surface.bsdf = bsdf_of(material, base, at);
    let is_glass = surface.bsdf.kind == GLASS;
    if !is_glass && dot(wo, normals.n_side) < 0.0 {
        normals = Normals(-normals.n_side, -normals.n_mapped);
    }
    if is_glass && materials[material].attenuation_distance_m > 0.0 {
        surface.inside = material + 1u;
    }
    surface.normals = normals;
    surface.frame = frame_around(seen_from(normals, wo));
    return surface;
}

/// What flux takes on at a bent normal beside the weight of radiance: `Flight::scattered`.
///
/// - `wi`: `drawn.wi`, turned into the scene
fn flux_over_radiance(surface: Surface, wo: vec3f, wi: vec3f, drawn: BsdfSample) -> f32 {
    let n_geo = surface.point.n_geo;
    if dot(wo, n_geo) * drawn.wi.z == 0.0 {
        return 1.0;
    }
    let arriving = abs(dot(wo, surface.frame.n) / dot(wo, n_geo));
    let leaving = abs(dot(wi, n_geo) / drawn.wi.z);
    if drawn.is_specular {
        return min(arriving * leaving, BENT_MAX);
    }
    return min(arriving, BENT_MAX) * leaving;
}

/// Share of light left after a way through what fills a material; `medium` as in [`Surface`].
fn transmittance(medium: u32, distance_m: f32) -> vec3f {
    if !HAS_GLASS || medium == 0u {
        return vec3f(1.0);
    }
    let color = materials[medium - 1u].attenuation_color;
    // Finite, however short the distance: a power of infinity is no number.
    let exponent = min(distance_m / max(materials[medium - 1u].attenuation_distance_m, LEAST_NORMAL), 1e30);
    let left = pow(max(color, vec3f(LEAST_NORMAL)), vec3f(exponent));
    return select(left, vec3f(0.0), (color <= vec3f(0.0)) & vec3<bool>(exponent > 0.0));
}
