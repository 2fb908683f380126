// Records drawn onto the pixels in which the spheres of their reach show, and added up there [Gautron2008, 8.3]: weight times irradiance,
// and weight. `technique/irradiance/splat.rs` does the same; the rectangle of a sphere is `View::pixels_of_sphere`.

@group(0) @binding(0) var<uniform> picture: Picture;
@group(0) @binding(1) var<storage, read> points: array<SeenPoint>;
/// Irradiance and weight of what finer caches have answered for; weight 0: they have not.
@group(0) @binding(2) var<storage, read> answers: array<vec4f>;
@group(0) @binding(3) var<storage, read> records: array<Record>;
@group(0) @binding(4) var<storage, read> record_words: array<u32>;

/// Added around the pixels of spheres, px: `path/view.rs`. Far more than rounding and the card's raster take a point out of its pixel.
const SPHERE_SLACK_PX: f32 = 0.05;
/// Beyond every picture, and far from where floats end.
const ENDLESS_EXTENT: f32 = 1e20;
/// Where the squared way from the eye to where its lines touch a sphere is less than this share of that to the middle, some hundred
/// roundings, the eye may be inside: the sphere may then show everywhere.
const BORDER_SHARE: f32 = 1e-5;

/// What a sphere takes up along an axis of the picture, at distance 1.
struct Extent {
    least: f32,
    most: f32,
    /// It does not lie behind the eye.
    is_there: bool,
}

/// `View::extent_of_sphere`, of perspective views.
fn extent_of_sphere(along: f32, depth_m: f32, radius_m: f32) -> Extent {
    var extent = Extent(-ENDLESS_EXTENT, ENDLESS_EXTENT, depth_m + radius_m > 0.0);
    let distance_m2 = along * along + depth_m * depth_m;
    let tangent_m2 = distance_m2 - radius_m * radius_m;
    if !(tangent_m2 > BORDER_SHARE * distance_m2) {
        return extent;
    }
    // Two lines from the eye touch the circle; one that goes backwards bounds nothing in front.
    let tangent_m = sqrt(tangent_m2);
    let ahead = depth_m * tangent_m + along * radius_m * vec2f(1.0, -1.0);
    let across = along * tangent_m + depth_m * radius_m * vec2f(-1.0, 1.0);
    if ahead.x > 0.0 {
        extent.least = max(across.x / ahead.x, -ENDLESS_EXTENT);
    }
    if ahead.y > 0.0 {
        extent.most = min(across.y / ahead.y, ENDLESS_EXTENT);
    }
    // From behind the eye it reaches into the picture on the side that it lies on, if at all.
    let is_bounded_there = select(ahead.x > 0.0, ahead.y > 0.0, along < 0.0);
    if depth_m < 0.0 && !is_bounded_there {
        extent.is_there = false;
    }
    return extent;
}

/// First pixel and the one after the last along an axis of so many; the same where there are none.
fn pixels_between(least: f32, most: f32, half_size: f32, count: u32) -> vec2f {
    let ends = 0.5 * (1.0 + vec2f(least, most) / half_size) * f32(count);
    let first = clamp(floor(ends.x - SPHERE_SLACK_PX), 0.0, f32(count));
    let end = clamp(floor(ends.y + SPHERE_SLACK_PX) + 1.0, 0.0, f32(count));
    return vec2f(first, max(first, end));
}

struct Corner {
    @builtin(position) position: vec4f,
    @location(0) @interpolate(flat) record: u32,
}

/// A corner of the two triangles that a record's rectangle is made of.
@vertex
fn corner(@builtin(vertex_index) vertex: u32, @builtin(instance_index) record: u32) -> Corner {
    let offset = records[record].position - picture.origin;
    let depth_m = -dot(offset, picture.back);
    let reach_m = records[record].reach_m;
    let across = extent_of_sphere(dot(offset, picture.right), depth_m, reach_m);
    let upwards = extent_of_sphere(dot(offset, picture.up), depth_m, reach_m);
    if !(across.is_there && upwards.is_there) {
        return Corner(vec4f(0.0, 0.0, 0.0, 1.0), record);
    }
    let columns = pixels_between(across.least, across.most, picture.half_width, picture.width);
    let rows = pixels_between(-upwards.most, -upwards.least, picture.half_height, picture.height);
    // Its corners 0, 1, 2 and 2, 1, 3, from the last one on.
    let which = (0x312210u >> (4u * vertex)) & 3u;
    let at = vec2f(
        select(columns.x, columns.y, (which & 1u) != 0u),
        select(rows.x, rows.y, (which & 2u) != 0u),
    );
    let size = vec2f(f32(picture.width), f32(picture.height));
    let position = (2.0 * at / size - 1.0) * vec2f(1.0, -1.0);
    return Corner(vec4f(position, 0.0, 1.0), record);
}

@fragment
fn splat(at: Corner) -> @location(0) vec4f {
    let pixel = u32(at.position.y) * picture.width + u32(at.position.x);
    if points[pixel].sees != SEES_DIFFUSE || answers[pixel].w > 0.0 {
        discard;
    }
    let facing = Facing(points[pixel].position, points[pixel].normal, points[pixel].n_geo);
    let weight = weight_of(cache_at(picture.cache), at.record, facing, false);
    if !(weight > 0.0) {
        discard;
    }
    return vec4f(irradiance_at(at.record, facing) * weight, weight);
}
