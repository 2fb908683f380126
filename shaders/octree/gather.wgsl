// What gathers of the octree are asked for, and the space that they look in: `technique/products/gather.rs`, whose numbers are prepended.

// `behind_m` names them one by one.
const_assert WALLS_MAX == 6u;

/// Where and how far to gather.
struct Asked {
    centre: vec3f,
    /// How far the first look reaches, m.
    radius_m: f32,
    normal: vec3f,
    /// Farthest look, m.
    radius_max_m: f32,
    /// Unit directions away from the middle, along the surface, and distances from it, m: of walls beyond which nothing counts. Without
    /// direction, and FAR_M away, those that are not there.
    walls: array<vec4f, WALLS_MAX>,
    /// Its sides in the list of all that are asked for: the first, and the one behind the last.
    first_side: u32,
    end_side: u32,
    /// Photons to be content with.
    count_min: u32,
    /// Photons at most, if the first look finds enough; `count_min` later.
    count_max: u32,
    padding_0: u32,
    padding_1: u32,
    padding_2: u32,
    padding_3: u32,
}

/// What a search found.
struct Found {
    radius_m: f32,
    /// Nothing farther had any influence, m.
    reach_m: f32,
    /// Least cosine of normals with the gather's: what faces farther away does not count.
    facing_cos: f32,
    /// Photons; more than a list takes where many lie at one point, and where a loop was cut short.
    count: u32,
    /// Photons that walls kept out.
    behind_count: u32,
}

struct Gathers {
    count: u32,
    /// Photons that the list of a gather takes.
    list_length: u32,
}

@group(0) @binding(0) var<uniform> gathers: Gathers;
@group(0) @binding(1) var<storage, read> asked: array<Asked>;
/// Sides that are asked for, gather by gather.
@group(0) @binding(2) var<storage, read> sides: array<u32>;

/// From the middle to the space in which the ellipsoid of the gather is a sphere, m.
fn flattened(from_middle: vec3f, normal: vec3f) -> vec3f {
    let along = normal.x * from_middle.x + normal.y * from_middle.y + normal.z * from_middle.z;
    return from_middle + normal * ((GATHER_FLATNESS - 1.0) * along);
}

fn length2(v: vec3f) -> f32 {
    return v.x * v.x + v.y * v.y + v.z * v.z;
}

fn cosine(a: vec3f, b: vec3f) -> f32 {
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

/// How far behind one of the walls a point lies; those that are not there are beyond everything.
fn behind_wall_m(gather: u32, wall: u32, from_middle: vec3f) -> f32 {
    let plane = asked[gather].walls[wall];
    return cosine(plane.xyz, from_middle) - plane.w;
}

/// How far behind the wall that it is farthest behind a point lies, negative before all, m. No loop: software drivers end all loops of
/// an invocation once they took 65,535 rounds together, and this is asked for every photon.
fn behind_m(gather: u32, from_middle: vec3f) -> f32 {
    let first = max(behind_wall_m(gather, 0u, from_middle), behind_wall_m(gather, 1u, from_middle));
    let second = max(behind_wall_m(gather, 2u, from_middle), behind_wall_m(gather, 3u, from_middle));
    let third = max(behind_wall_m(gather, 4u, from_middle), behind_wall_m(gather, 5u, from_middle));
    return max(first, max(second, third));
}

/// A loop ended before its time: what was found is not whole.
var<private> is_cut_short: bool;
/// Nodes, photons and triangles that were looked at: up to WORK_MAX and a leaf, so that no submission takes as long as a watchdog waits.
var<private> work: u32;

fn gather_of(group: vec3u, groups: vec3u, invocation: u32) -> u32 {
    return (group.y * groups.x + group.x) * WORKGROUP + invocation;
}
