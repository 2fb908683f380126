// What surfaces are made of: placements, vertices, materials, texels, as `transport/upload.rs` packs them.

struct SceneHeader {
    /// Kinds of far lights, in the order in which they are chosen: directional ones, then the environment.
    directional_count: u32,
    /// 0 none, 1 the same from everywhere, 2 a picture.
    environment_kind: u32,
    light_node_count: u32,
    /// Where in `tables` the way to each light from the tree's root begins, two words each.
    trails_at: u32,
    environment_radiance: vec3f,
    environment_rotation_rad: f32,
    /// Of the environment's picture, in `texels`, four floats each.
    environment_at: u32,
    environment_width: u32,
    environment_height: u32,
    /// Running sums over its rows, then over the texels of each row, in `tables`.
    environment_sums_at: u32,
    /// Directional lights in `lights` begin here, after the local ones.
    directional_at: u32,
    /// Of the environment's picture, as those of [`TextureUse`].
    environment_flags: u32,
    padding_0: u32,
    padding_1: u32,
}

/// A mesh where it stands. `…_at`: words of `geometry`, `ABSENT` where the mesh has none.
struct Placement {
    render_from_mesh_x: vec3f,
    normals_at: u32,
    render_from_mesh_y: vec3f,
    tangents_at: u32,
    render_from_mesh_z: vec3f,
    texcoords_0_at: u32,
    normal_from_mesh_x: vec3f,
    texcoords_1_at: u32,
    normal_from_mesh_y: vec3f,
    colors_at: u32,
    normal_from_mesh_z: vec3f,
    corners_at: u32,
    centre_in_render: vec3f,
    positions_at: u32,
    /// Unit normals of the triangles, in mesh space.
    faces_at: u32,
    /// First triangle and material of each primitive.
    primitives_at: u32,
    primitive_count: u32,
    /// 1: only moved; 2: mirrored.
    flags: u32,
    /// First triangle, triangles, first light and level of the cut of each run that emits.
    runs_at: u32,
    run_count: u32,
    padding_0: u32,
    padding_1: u32,
}

/// A material's use of a texture.
struct TextureUse {
    uv_x: vec2f,
    uv_y: vec2f,
    uv_offset: vec2f,
    /// First texel, in words.
    texels_at: u32,
    width: u32,
    height: u32,
    /// `TEXTURE_…`.
    flags: u32,
    padding_0: u32,
    padding_1: u32,
}

struct Material {
    base_color: vec3f,
    alpha: f32,
    emission: vec3f,
    /// Below 0: no mask.
    alpha_cutoff: f32,
    specular_color: vec3f,
    specular: f32,
    attenuation_color: vec3f,
    /// 0: clear.
    attenuation_distance_m: f32,
    metallic: f32,
    roughness: f32,
    ior: f32,
    transmission: f32,
    normal_scale: f32,
    /// 1: emits from both sides; 2: unlit.
    flags: u32,
    padding_0: u32,
    padding_1: u32,
    textures: array<TextureUse, 7>,
}

const ABSENT: u32 = 0xffffffffu;
const ONLY_MOVED: u32 = 1u;
const MIRRORED: u32 = 2u;
const TWO_SIDED: u32 = 1u;
const UNLIT: u32 = 2u;

const BASE_COLOR: u32 = 0u;
const METALLIC_ROUGHNESS: u32 = 1u;
const NORMAL: u32 = 2u;
const EMISSION: u32 = 3u;
const SPECULAR: u32 = 4u;
const SPECULAR_COLOR: u32 = 5u;
const TRANSMISSION: u32 = 6u;

@group(1) @binding(0) var<uniform> scene: SceneHeader;
@group(1) @binding(1) var<storage, read> placements: array<Placement>;
@group(1) @binding(2) var<storage, read> geometry: array<u32>;
@group(1) @binding(3) var<storage, read> materials: array<Material>;
@group(1) @binding(4) var<storage, read> texels: array<u32>;
/// 0–4095: sums of Sobol's direction numbers, four words each; 4096–4351: linear values of sRGB bytes; then what `scene` says.
@group(1) @binding(5) var<storage, read> tables: array<u32>;

fn sobol_sum(position: u32, byte: u32) -> vec4u {
    let at = (position * 256u + byte) * 4u;
    return vec4u(tables[at], tables[at + 1u], tables[at + 2u], tables[at + 3u]);
}

fn linear_of_srgb(byte: u32) -> f32 {
    return bitcast<f32>(tables[4096u + byte]);
}

fn geometry_vec2(at: u32, index: u32) -> vec2f {
    let first = at + 2u * index;
    return vec2f(bitcast<f32>(geometry[first]), bitcast<f32>(geometry[first + 1u]));
}

fn geometry_vec3(at: u32, index: u32) -> vec3f {
    let first = at + 3u * index;
    return vec3f(bitcast<f32>(geometry[first]), bitcast<f32>(geometry[first + 1u]), bitcast<f32>(geometry[first + 2u]));
}

fn geometry_vec4(at: u32, index: u32) -> vec4f {
    let first = at + 4u * index;
    return vec4f(
        bitcast<f32>(geometry[first]),
        bitcast<f32>(geometry[first + 1u]),
        bitcast<f32>(geometry[first + 2u]),
        bitcast<f32>(geometry[first + 3u]),
    );
}

fn corners_of(instance: u32, triangle: u32) -> vec3u {
    let at = placements[instance].corners_at + 3u * triangle;
    return vec3u(geometry[at], geometry[at + 1u], geometry[at + 2u]);
}

/// Index into `materials` of what a triangle is made of.
fn material_of(instance: u32, triangle: u32) -> u32 {
    let at = placements[instance].primitives_at;
    var low = 0u;
    var high = placements[instance].primitive_count;
    // The last primitive that begins at or before the triangle.
    while high - low > 1u {
        let middle = (low + high) / 2u;
        if geometry[at + 2u * middle] <= triangle {
            low = middle;
        } else {
            high = middle;
        }
    }
    return geometry[at + 2u * low + 1u];
}

fn to_render(instance: u32, v: vec3f) -> vec3f {
    return placements[instance].render_from_mesh_x * v.x + placements[instance].render_from_mesh_y * v.y
        + placements[instance].render_from_mesh_z * v.z;
}

fn normal_to_render(instance: u32, n: vec3f) -> vec3f {
    return placements[instance].normal_from_mesh_x * n.x + placements[instance].normal_from_mesh_y * n.y
        + placements[instance].normal_from_mesh_z * n.z;
}

/// A point of a surface, with what rays need to leave it.
struct SurfacePoint {
    position: vec3f,
    n_geo: vec3f,
    error_m: f32,
}

/// Which way a triangle faces.
fn face_of(instance: u32, triangle: u32) -> vec3f {
    let face = geometry_vec3(placements[instance].faces_at, triangle);
    if (placements[instance].flags & ONLY_MOVED) != 0u {
        return face;
    }
    return normalize_or(normal_to_render(instance, face), vec3f(0.0, 0.0, 1.0));
}

/// `Instance::surface_point`: the same bound on what rounding moves it by.
fn surface_point(instance: u32, triangle: u32, b1: f32, b2: f32) -> SurfacePoint {
    let corners = corners_of(instance, triangle);
    let positions_at = placements[instance].positions_at;
    let v0 = geometry_vec3(positions_at, corners.x);
    let v1 = geometry_vec3(positions_at, corners.y);
    let v2 = geometry_vec3(positions_at, corners.z);
    let p_in_mesh = v0 * (1.0 - b1 - b2) + v1 * b1 + v2 * b2;
    let centre = placements[instance].centre_in_render;
    let is_only_moved = (placements[instance].flags & ONLY_MOVED) != 0u;
    let n_geo = face_of(instance, triangle);
    var turned = p_in_mesh;
    if !is_only_moved {
        turned = to_render(instance, p_in_mesh);
    }
    let position = turned + centre;
    let extent = max(abs(v0), max(abs(v1), abs(v2))) * GAMMA_19;
    let bound = abs(placements[instance].render_from_mesh_x) * extent.x
        + abs(placements[instance].render_from_mesh_y) * extent.y
        + abs(placements[instance].render_from_mesh_z) * extent.z
        + (abs(centre) + abs(position)) * GAMMA_5;
    return SurfacePoint(position, n_geo, dot(bound, abs(n_geo)));
}

/// Where a ray towards `direction` starts.
fn origin_towards(point: SurfacePoint, direction: vec3f) -> vec3f {
    return point.position + point.n_geo * copysign(point.error_m, dot(direction, point.n_geo));
}

/// Interpolated vertex data at a hit.
struct Interpolated {
    texcoords_0: vec2f,
    texcoords_1: vec2f,
    color: vec4f,
}

fn texcoord_at(at: u32, corners: vec3u, weights: vec3f) -> vec2f {
    if at == ABSENT {
        return vec2f(0.0);
    }
    return geometry_vec2(at, corners.x) * weights.x + geometry_vec2(at, corners.y) * weights.y
        + geometry_vec2(at, corners.z) * weights.z;
}

fn interpolated(instance: u32, corners: vec3u, weights: vec3f) -> Interpolated {
    var at = Interpolated(vec2f(0.0), vec2f(0.0), vec4f(1.0));
    if HAS_TEXTURES {
        at.texcoords_0 = texcoord_at(placements[instance].texcoords_0_at, corners, weights);
        at.texcoords_1 = texcoord_at(placements[instance].texcoords_1_at, corners, weights);
    }
    let colors_at = placements[instance].colors_at;
    if colors_at != ABSENT {
        let color = geometry_vec4(colors_at, corners.x) * weights.x + geometry_vec4(colors_at, corners.y) * weights.y
            + geometry_vec4(colors_at, corners.z) * weights.z;
        at.color = clamp(color, vec4f(0.0), vec4f(1.0));
    }
    return at;
}

/// Whole texel coordinate → column or row.
fn wrapped(coordinate: f32, size: u32, wrap: u32) -> u32 {
    // Beyond 2³⁰ a float tells every 64th texel only: which one is shown is no matter.
    let i = i32(clamp(coordinate, -1073741824.0, 1073741824.0));
    let n = i32(size);
    if wrap == 2u {
        return u32(clamp(i, 0, n - 1));
    }
    let period = select(n, 2 * n, wrap == 1u);
    var folded = i % period;
    if folded < 0 {
        folded += period;
    }
    return u32(select(folded, min(folded, 2 * n - 1 - folded), wrap == 1u));
}

fn texel(at: u32, flags: u32, index: u32) -> vec4f {
    if (flags & TEXTURE_FLOATS) != 0u {
        let first = at + 4u * index;
        return vec4f(
            bitcast<f32>(texels[first]),
            bitcast<f32>(texels[first + 1u]),
            bitcast<f32>(texels[first + 2u]),
            bitcast<f32>(texels[first + 3u]),
        );
    }
    let word = texels[at + index];
    let bytes = vec4u(word & 0xffu, (word >> 8u) & 0xffu, (word >> 16u) & 0xffu, word >> 24u);
    if (flags & TEXTURE_SRGB) != 0u {
        return vec4f(
            linear_of_srgb(bytes.x),
            linear_of_srgb(bytes.y),
            linear_of_srgb(bytes.z),
            f32(bytes.w) * (1.0 / 255.0),
        );
    }
    return vec4f(bytes) * (1.0 / 255.0);
}

/// The picture's value in a slot of a material, or `otherwise`.
fn sampled(material: u32, slot: u32, at: Interpolated, otherwise: vec4f) -> vec4f {
    if !HAS_TEXTURES {
        return otherwise;
    }
    let flags = materials[material].textures[slot].flags;
    if (flags & TEXTURE_IS_THERE) == 0u {
        return otherwise;
    }
    let texture = materials[material].textures[slot];
    let coordinate = select(at.texcoords_0, at.texcoords_1, (flags & TEXTURE_SECOND_SET) != 0u);
    var uv = texture.uv_x * coordinate.x + texture.uv_y * coordinate.y + texture.uv_offset;
    if !(abs(uv.x) < 1e9 && abs(uv.y) < 1e9) {
        uv = vec2f(0.0);
    }
    let wrap_u = (flags >> TEXTURE_WRAP_U_SHIFT) & 3u;
    let wrap_v = (flags >> TEXTURE_WRAP_V_SHIFT) & 3u;
    let size = vec2f(f32(texture.width), f32(texture.height));
    if (flags & TEXTURE_NEAREST) != 0u {
        let place = floor(uv * size);
        let column = wrapped(place.x, texture.width, wrap_u);
        let row = wrapped(place.y, texture.height, wrap_v);
        return texel(texture.texels_at, flags, row * texture.width + column);
    }
    let place = uv * size - 0.5;
    let base = floor(place);
    let share = place - base;
    let left = wrapped(base.x, texture.width, wrap_u);
    let right = wrapped(base.x + 1.0, texture.width, wrap_u);
    let upper = wrapped(base.y, texture.height, wrap_v) * texture.width;
    let lower = wrapped(base.y + 1.0, texture.height, wrap_v) * texture.width;
    let in_upper = mix(
        texel(texture.texels_at, flags, upper + left),
        texel(texture.texels_at, flags, upper + right),
        share.x,
    );
    let in_lower = mix(
        texel(texture.texels_at, flags, lower + left),
        texel(texture.texels_at, flags, lower + right),
        share.x,
    );
    return mix(in_upper, in_lower, share.y);
}

/// False where an alpha mask cuts the surface away.
fn is_present(instance: u32, triangle: u32, b1: f32, b2: f32) -> bool {
    let material = material_of(instance, triangle);
    let cutoff = materials[material].alpha_cutoff;
    if cutoff < 0.0 {
        return true;
    }
    let at = interpolated(instance, corners_of(instance, triangle), vec3f(1.0 - b1 - b2, b1, b2));
    return materials[material].alpha * sampled(material, BASE_COLOR, at, vec4f(1.0)).w * at.color.w >= cutoff;
}
