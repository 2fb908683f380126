// Which share of a light arrives, by what that sees: `ShadowMaps::lit_share`.

@group(3) @binding(0) var<storage, read> shadow_planes: array<ShadowPlane>;
/// By light: the first of its planes, and how many it has.
@group(3) @binding(1) var<storage, read> planes_of_lights: array<vec2u>;
/// Of all planes, row by row; 0 where nothing is seen.
@group(3) @binding(2) var<storage, read> nearnesses: array<f32>;

/// The map does not say, and a ray is to be traced.
const ASKS_FOR_RAY: f32 = -1.0;

/// Of the six planes of a light that shines everywhere, the one before which something lies.
fn face_before(from_light: vec3f) -> u32 {
    let size = abs(from_light);
    if size.x >= size.y && size.x >= size.z {
        return select(0u, 1u, from_light.x < 0.0);
    }
    if size.y >= size.z {
        return select(2u, 3u, from_light.y < 0.0);
    }
    return select(4u, 5u, from_light.z < 0.0);
}

/// Share of the light that arrives where a shadow ray begins: of the texels around, those that see nothing nearer than a flat
/// surface would be there; or `ASKS_FOR_RAY`.
fn lit_share(shadow: Shadow) -> f32 {
    let light = shadow.light;
    if light == NO_INDEX || planes_of_lights[light].y == 0u {
        return ASKS_FOR_RAY;
    }
    let p = shadow.origin;
    let n = face_of(shadow.left_instance, shadow.left_triangle);
    var pixel_m = 2.0 * pass_header.half_width / f32(pass_header.width);
    if pass_header.is_perspective != 0u {
        pixel_m *= distance(p, pass_header.origin);
    }
    var number = planes_of_lights[light].x;
    if planes_of_lights[light].y > 1u {
        number += face_before(p - shadow_planes[number].origin);
    }
    let plane = shadow_planes[number];
    let from_light = p - plane.origin;
    let ahead = -dot(from_light, plane.back);
    let half_size = vec2f(plane.half_width, plane.half_height);
    let side = f32(plane.side);
    let texel = 2.0 * max(half_size.x, half_size.y) / side;
    let tilt = vec2f(dot(n, plane.right), dot(n, plane.up)) * half_size;
    var at = vec2f(dot(from_light, plane.right), dot(from_light, plane.up)) / half_size;
    var nearness = 1.0 - ahead / plane.reach_m;
    var texel_m = texel;
    // Nearness that as much of a texel's size makes.
    var room = SHADOW_ROOM_TEXELS * texel / plane.reach_m;
    // What light falls onto the surface at, and by how much the surface is nearer for each 1 to the right and upwards.
    var cosine = -dot(n, plane.back);
    var steeper = tilt / (cosine * plane.reach_m);
    if plane.is_perspective != 0u {
        if !(ahead > plane.reach_m) {
            return ASKS_FOR_RAY;
        }
        at /= ahead;
        nearness = plane.reach_m / ahead;
        texel_m = texel * ahead;
        room = SHADOW_ROOM_TEXELS * texel * nearness;
        let height = dot(n, from_light);
        cosine = height / length(from_light);
        steeper = tilt * (plane.reach_m / height);
    }
    // Light that falls from the side stretches texels over the surface; where it grazes, rounding and what is between them decide.
    let pixel_in_light_m = pixel_m * abs(cosine);
    let is_known = abs(cosine) >= SHADOW_COS_LEAST && max(abs(at.x), abs(at.y)) <= 1.0
        && texel_m <= SHADOW_TEXEL_MOST * pixel_in_light_m;
    if !is_known {
        return ASKS_FOR_RAY;
    }
    let place = vec2f(0.5 + 0.5 * at.x, 0.5 - 0.5 * at.y) * side;
    let middle = clamp(floor(place), vec2f(0.0), vec2f(side - 1.0));
    let within = clamp(place - middle, vec2f(0.0), vec2f(1.0));
    var lit = 0.0;
    for (var row = 0u; row < 3u; row++) {
        for (var column = 0u; column < 3u; column++) {
            let tap = clamp(middle + vec2f(f32(column), f32(row)) - 1.0, vec2f(0.0), vec2f(side - 1.0));
            let apart = (tap + 0.5 - place) * vec2f(2.0, -2.0) / side;
            let index = plane.first_texel + u32(tap.y) * plane.side + u32(tap.x);
            // Nothing is at nearness 0, however far the surface would be there.
            if nearnesses[index] <= max(nearness + dot(steeper, apart) + room, 0.0) {
                lit += weight_of(column, within.x) * weight_of(row, within.y);
            }
        }
    }
    // Texels that agree are believed; where they do not, a ray tells more than the mean of coarse ones.
    let is_edge = lit > SHADOW_SURE && lit < 1.0 - SHADOW_SURE;
    if is_edge && texel_m > SHADOW_TEXEL_SMOOTH * pixel_in_light_m {
        return ASKS_FOR_RAY;
    }
    return select(lit, round(lit), !is_edge);
}

/// Of the last, the same and the next texel, by how far into its own something lies: they add up to 1.
fn weight_of(which: u32, within: f32) -> f32 {
    if which == 1u {
        return 0.5;
    }
    return 0.5 * select(within, 1.0 - within, which == 0u);
}
