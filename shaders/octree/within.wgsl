// How much of the surfaces of gathers lies within their reach, side by side: `Surfaces::within`. One invocation a gather, which takes
// WORK_MAX nodes and triangles at most: what needs more is cut short.

/// Some triangles that lie together; those behind it in depth-first order, up to `end`, are its parts.
struct ExtentNode {
    middle: vec3f,
    /// No corner lies farther from the middle, m.
    reach_m: f32,
    /// Axis of the cone that holds all normals, and cosine and sine of its half angle.
    axis: vec3f,
    cone_cos: f32,
    facing_m2: vec3f,
    area_m2: f32,
    squares_m2: vec3f,
    cone_sin: f32,
    products_m2: vec3f,
    end: u32,
    /// First triangle, eight times, and how many; none of what has parts.
    faces: u32,
    padding_0: u32,
    padding_1: u32,
    padding_2: u32,
}

/// Some piece of surface, as light from afar sees it.
struct Facets {
    facing_m2: vec3f,
    area_m2: f32,
    /// Sums of the squares and products of its parts' normals, by their area.
    squares_m2: vec3f,
    padding_0: f32,
    products_m2: vec3f,
    padding_1: f32,
}

@group(0) @binding(3) var<storage, read> found: array<Found>;
/// By surface: its first node, and the one behind its last.
@group(0) @binding(4) var<storage, read> surfaces: array<vec2u>;
@group(0) @binding(5) var<storage, read> extents: array<ExtentNode>;
@group(0) @binding(6) var<storage, read> faces: array<Face>;
/// Of the sides that are asked for.
@group(0) @binding(7) var<storage, read_write> areas: array<Facets>;

/// The gather, as the front of a surface sees it.
struct Look {
    gather: u32,
    centre: vec3f,
    normal: vec3f,
    radius_m: f32,
    facing_cos: f32,
    /// Pieces of surface no larger are not cut, m².
    small_m2: f32,
}

/// Stands for the area of what a loop that was cut short left out.
const CUT_SHORT_M2: f32 = -1.0;

const FACES_NONE: u32 = 0u;
const FACES_SOME: u32 = 1u;
const FACES_ALL: u32 = 2u;

/// Which of the normals of a node face the gather's.
fn facing_of(node: u32, look: Look) -> u32 {
    let cone_cos = extents[node].cone_cos;
    let axis_cos = clamp(cosine(extents[node].axis, look.normal), -1.0, 1.0);
    let across = sqrt(1.0 - axis_cos * axis_cos) * extents[node].cone_sin;
    let reached = axis_cos * cone_cos;
    if look.facing_cos <= -1.0 || (axis_cos >= -cone_cos && reached - across >= look.facing_cos) {
        return FACES_ALL;
    }
    if axis_cos < cone_cos && reached + across < look.facing_cos {
        return FACES_NONE;
    }
    return FACES_SOME;
}

/// Share of a triangle that lies within.
fn share_of_face(face: u32, look: Look) -> f32 {
    let cos = cosine(faces[face].normal, look.normal);
    if cos < look.facing_cos {
        return 0.0;
    }
    // The more a triangle leans, the more flattening makes it reach farther.
    let own_reach_m = faces[face].reach_m;
    let stretched2 = 1.0 + (GATHER_FLATNESS * GATHER_FLATNESS - 1.0) * max(1.0 - cos * cos, 0.0);
    let reach_m = own_reach_m * sqrt(stretched2);
    let from_middle = faces[face].middle - look.centre;
    let distance_m = sqrt(length2(flattened(from_middle, look.normal)));
    let behind = behind_m(look.gather, from_middle);
    if distance_m >= look.radius_m + reach_m || behind >= own_reach_m {
        return 0.0;
    }
    let is_small = own_reach_m <= GATHER_SMALL * look.radius_m && faces[face].area_m2 <= look.small_m2;
    let inside_m = look.radius_m - distance_m;
    let is_before = behind <= -own_reach_m;
    if is_small {
        let before = select(share_within(-behind, own_reach_m), 1.0, is_before);
        let is_whole = is_before && distance_m + reach_m <= look.radius_m;
        return select(share_within(inside_m, own_reach_m), 1.0, is_whole) * before;
    }
    if is_before && distance_m + reach_m <= look.radius_m {
        return 1.0;
    }
    // In radii of the gather, whatever the size of the scene.
    let per_m = 1.0 / max(look.radius_m, 1.0 / FAR_M);
    let corners = array<vec3f, 3>(
        (faces[face].a - look.centre) * per_m,
        (faces[face].b - look.centre) * per_m,
        (faces[face].c - look.centre) * per_m,
    );
    let size = max(abs(corners[0]), max(abs(corners[1]), abs(corners[2])));
    if !(max(size.x, max(size.y, size.z)) <= CORNER_MAX) {
        is_cut_short = true;
        return 0.0;
    }
    if !is_before {
        return share_before_walls(look.gather, look.normal, per_m, corners);
    }
    let a = flattened(corners[0], look.normal);
    let b = flattened(corners[1], look.normal);
    let c = flattened(corners[2], look.normal);
    return share_of(area_in_sphere(a, b, c), a, b, c);
}

fn add(sum: Facets, more: Facets) -> Facets {
    return Facets(
        sum.facing_m2 + more.facing_m2,
        sum.area_m2 + more.area_m2,
        sum.squares_m2 + more.squares_m2,
        0.0,
        sum.products_m2 + more.products_m2,
        0.0,
    );
}

fn flat(area_m2: f32, n: vec3f) -> Facets {
    return Facets(n * area_m2, area_m2, n * n * area_m2, 0.0, vec3f(n.x * n.y, n.y * n.z, n.z * n.x) * area_m2, 0.0);
}

fn facets_of(node: u32, share: f32) -> Facets {
    return Facets(
        extents[node].facing_m2 * share,
        extents[node].area_m2 * share,
        extents[node].squares_m2 * share,
        0.0,
        extents[node].products_m2 * share,
        0.0,
    );
}

const NOTHING: Facets = Facets(vec3f(0.0), 0.0, vec3f(0.0), 0.0, vec3f(0.0), 0.0);

/// What faces the gather of some triangles.
///
/// - `leaf`: as a node names them
fn facing_faces(leaf: u32, look: Look) -> Facets {
    var sum = NOTHING;
    let end = (leaf >> 3u) + (leaf & 7u);
    work += leaf & 7u;
    for (var face = leaf >> 3u; face < end; face++) {
        if cosine(faces[face].normal, look.normal) >= look.facing_cos {
            sum = add(sum, flat(faces[face].area_m2, faces[face].normal));
        }
    }
    return sum;
}

fn of_surface(root: vec2u, look: Look) -> Facets {
    var sum = NOTHING;
    var node = root.x;
    // Where the parts end of what lies wholly within reach: where those lie is not asked.
    var within_end = root.x;
    while node < root.y && work < WORK_MAX {
        work += 1u;
        if node < within_end {
            let facing = facing_of(node, look);
            if facing != FACES_SOME {
                if facing == FACES_ALL {
                    sum = add(sum, facets_of(node, 1.0));
                }
                node = extents[node].end;
                continue;
            }
            sum = add(sum, facing_faces(extents[node].faces, look));
            node += 1u;
            continue;
        }
        let reach_m = extents[node].reach_m;
        let from_middle = extents[node].middle - look.centre;
        let size = abs(from_middle);
        let least_m = look.radius_m + reach_m;
        // The farthest first: its square is in the range of floats then.
        if max(size.x, max(size.y, size.z)) >= least_m || length2(from_middle) >= least_m * least_m {
            node = extents[node].end;
            continue;
        }
        let flattened_m = sqrt(length2(flattened(from_middle, look.normal)));
        let facing = facing_of(node, look);
        // What leans reaches farther in the flattened space, at most so many times.
        let reach_flattened_m = GATHER_FLATNESS * reach_m;
        let behind = behind_m(look.gather, from_middle);
        if facing == FACES_NONE || behind >= reach_m || flattened_m >= look.radius_m + reach_flattened_m {
            node = extents[node].end;
            continue;
        }
        if behind <= -reach_m && flattened_m + reach_flattened_m <= look.radius_m {
            within_end = extents[node].end;
            continue;
        }
        let is_small = reach_m <= GATHER_SMALL * look.radius_m && extents[node].area_m2 <= look.small_m2;
        if facing == FACES_ALL && behind <= -reach_m && is_small {
            sum = add(sum, facets_of(node, share_within(look.radius_m - flattened_m, reach_m)));
            node = extents[node].end;
            continue;
        }
        let leaf = extents[node].faces;
        let end = (leaf >> 3u) + (leaf & 7u);
        work += leaf & 7u;
        var part = NOTHING;
        var face = leaf >> 3u;
        for (; face < end; face++) {
            part = add(part, flat(faces[face].area_m2 * share_of_face(face, look), faces[face].normal));
        }
        is_cut_short = is_cut_short || face < end;
        sum = add(sum, part);
        node += 1u;
    }
    is_cut_short = is_cut_short || node < root.y;
    return sum;
}

@compute @workgroup_size(WORKGROUP)
fn within(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) invocation: u32,
) {
    let gather = gather_of(group, groups, invocation);
    if gather >= gathers.count {
        return;
    }
    // Where there is nothing, nobody asks how much surface holds it.
    if found[gather].count == 0u && found[gather].behind_count == 0u {
        return;
    }
    // What was cut short, or has no room, is the CPU's as it is.
    if found[gather].count > gathers.list_length {
        return;
    }
    var place = asked[gather].first_side;
    for (; place < asked[gather].end_side; place++) {
        let side = sides[place];
        let root = surfaces[side >> 1u];
        let is_front = (side & 1u) == 0u;
        let normal = asked[gather].normal;
        var look = Look(
            gather,
            asked[gather].centre,
            select(-normal, normal, is_front),
            found[gather].radius_m,
            found[gather].facing_cos,
            0.0,
        );
        if root.x < root.y {
            look.small_m2 = GATHER_SMALL * GATHER_SMALL * extents[root.x].area_m2;
        }
        var facets = of_surface(root, look);
        facets.facing_m2 = select(-facets.facing_m2, facets.facing_m2, is_front);
        areas[place] = facets;
    }
    if is_cut_short || place < asked[gather].end_side {
        areas[asked[gather].first_side].area_m2 = CUT_SHORT_M2;
    }
}
