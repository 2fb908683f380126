// How much of a triangle lies within a gather: `technique/products/extent.rs`, and the areas of `patch.rs` in floats.

struct Face {
    a: vec3f,
    area_m2: f32,
    b: vec3f,
    /// Farthest corner from its middle, m.
    reach_m: f32,
    c: vec3f,
    padding_0: f32,
    /// Of its front, unit.
    normal: vec3f,
    padding_1: f32,
    middle: vec3f,
    padding_2: f32,
}

/// Corners of a triangle cut by all walls, at most; rounding may find one more, which bounds no area worth keeping.
const CORNERS_MAX: u32 = 3u + WALLS_MAX;
const PI: f32 = 3.14159265358979;

/// Farthest corner of a triangle that is cut, in radii of the gather. Its edges are as far off as some units in the last place of that, and
/// the area with them: at ten thousand by 7e-5 of the disc in the mean and 5e-4 at most, at a million by 7e-3 and 5 %.
const CORNER_MAX: f32 = 1e4;

/// The angle from the x axis, in (−π, π]: a polynomial [Moshier1989], since WGSL's may be off by 4096 units in the last place.
fn angle_of(y: f32, x: f32) -> f32 {
    let larger = max(abs(x), abs(y));
    if larger == 0.0 {
        return 0.0;
    }
    // Of at most 45°, and of at most 22.5°.
    let slope = min(abs(x), abs(y)) / larger;
    let is_steep = slope > 0.41421356;
    let t = select(slope, (slope - 1.0) / (slope + 1.0), is_steep);
    let z = t * t;
    let series = (((8.05374449538e-2 * z - 1.38776856032e-1) * z + 1.99777106478e-1) * z - 3.33329491539e-1) * z * t + t;
    var angle = series + select(0.0, 0.25 * PI, is_steep);
    angle = select(angle, 0.5 * PI - angle, abs(y) > abs(x));
    angle = select(angle, PI - angle, x < 0.0);
    return select(angle, -angle, y < 0.0);
}

/// An edge in the plane of a disc, relative to the disc's centre.
struct Edge {
    start: vec3f,
    along: vec3f,
    /// Twice the signed area of the triangle (centre, edge).
    turn: f32,
}

/// Where an edge enters and leaves the disc, as shares of its length; nowhere if the first is not below the second.
fn run_in_disc(edge: Edge, disc2: f32) -> vec2f {
    let length_squared = length2(edge.along);
    if length_squared == 0.0 {
        return vec2f(1.0, 0.0);
    }
    let middle = -cosine(edge.start, edge.along) / length_squared;
    let half_squared = (disc2 - edge.turn * edge.turn / length_squared) / length_squared;
    let half = sqrt(max(half_squared, 0.0));
    return vec2f(max(middle - half, 0.0), min(middle + half, 1.0));
}

/// Signed area of the disc's sector that a run of the edge is seen under.
fn sector(edge: Edge, run: vec2f, disc2: f32) -> f32 {
    if run.x == run.y {
        return 0.0;
    }
    let p = edge.start + edge.along * run.x;
    let q = edge.start + edge.along * run.y;
    return 0.5 * disc2 * angle_of(edge.turn * (run.y - run.x), cosine(p, q));
}

/// Area of the part of a triangle inside the unit sphere around the origin.
fn area_in_sphere(a: vec3f, b: vec3f, c: vec3f) -> f32 {
    let area_vector = 0.5 * cross(b - a, c - a);
    let area = sqrt(length2(area_vector));
    if !(area > 0.0) {
        return 0.0;
    }
    if max(length2(a), max(length2(b), length2(c))) <= 1.0 {
        return area;
    }
    let normal = area_vector / area;
    let height = cosine(normal, a);
    let disc2 = 1.0 - height * height;
    if !(disc2 > 0.0) {
        return 0.0;
    }
    let foot = normal * height;
    var edges = array<Edge, 3>(
        Edge(a - foot, b - a, 0.0),
        Edge(b - foot, c - b, 0.0),
        Edge(c - foot, a - c, 0.0),
    );
    var sum = 0.0;
    var is_met = false;
    var holds_disc = true;
    for (var k = 0u; k < 3u; k++) {
        edges[k].turn = cosine(cross(edges[k].start, edges[k].along), normal);
        holds_disc = holds_disc && edges[k].turn >= 0.0;
        let run = run_in_disc(edges[k], disc2);
        if run.x < run.y {
            is_met = true;
            sum += sector(edges[k], vec2f(0.0, run.x), disc2) + 0.5 * edges[k].turn * (run.y - run.x)
                + sector(edges[k], vec2f(run.y, 1.0), disc2);
        } else {
            sum += sector(edges[k], vec2f(0.0, 1.0), disc2);
        }
    }
    let bound = min(area, PI * disc2);
    if !is_met {
        return select(0.0, bound, holds_disc);
    }
    return clamp(sum, 0.0, bound);
}

/// About how much of a piece lies within that has its middle so far inside the rim, in [0, 1].
fn share_within(inside_m: f32, reach_m: f32) -> f32 {
    if abs(inside_m) >= reach_m {
        return select(0.0, 1.0, inside_m > 0.0);
    }
    return 0.5 + 0.5 * inside_m / reach_m;
}

/// Of a triangle in the flattened space the share that lies within the gather's rim.
fn share_of(part: f32, a: vec3f, b: vec3f, c: vec3f) -> f32 {
    let whole = 0.5 * sqrt(length2(cross(b - a, c - a)));
    if part > 0.0 && whole > 0.0 {
        return min(part / whole, 1.0);
    }
    return 0.0;
}

/// Share of a triangle before the walls and within the rim.
///
/// - `corners`: from the middle of the gather, in its radii, of which a metre has `per_m`
fn share_before_walls(gather: u32, normal: vec3f, per_m: f32, corners: array<vec3f, 3>) -> f32 {
    var polygon: array<vec3f, CORNERS_MAX>;
    polygon[0] = corners[0];
    polygon[1] = corners[1];
    polygon[2] = corners[2];
    var count = 3u;
    for (var wall = 0u; wall < WALLS_MAX; wall++) {
        let plane = asked[gather].walls[wall];
        var kept: array<vec3f, CORNERS_MAX>;
        var kept_count = 0u;
        for (var place = 0u; place < count; place++) {
            let p = polygon[place];
            let q = polygon[select(place + 1u, 0u, place + 1u == count)];
            let here = cosine(plane.xyz, p) - plane.w * per_m;
            let there = cosine(plane.xyz, q) - plane.w * per_m;
            if here <= 0.0 && kept_count < CORNERS_MAX {
                kept[kept_count] = p;
                kept_count += 1u;
            }
            if (here <= 0.0) != (there <= 0.0) && kept_count < CORNERS_MAX {
                kept[kept_count] = p + (q - p) * (here / (here - there));
                kept_count += 1u;
            }
        }
        polygon = kept;
        count = kept_count;
    }
    var part = 0.0;
    let first = flattened(polygon[0], normal);
    for (var last = 2u; last < count; last++) {
        part += area_in_sphere(first, flattened(polygon[last - 1u], normal), flattened(polygon[last], normal));
    }
    return share_of(
        part,
        flattened(corners[0], normal),
        flattened(corners[1], normal),
        flattened(corners[2], normal),
    );
}
