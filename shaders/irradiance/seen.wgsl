// The surfaces that the middles of pixels see, of the triangles that `path/planes.wgsl` has drawn there.

@group(2) @binding(0) var<uniform> picture: Picture;
/// Instance, triangle, and the weights of its second and third vertex, in rows of `picture.row`.
@group(2) @binding(1) var<storage, read> drawn: array<vec4u>;
@group(2) @binding(2) var<storage, read_write> points: array<SeenPoint>;

@compute @workgroup_size(WORKGROUP)
fn seen(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) invocation: u32,
) {
    let pixel = (group.y * groups.x + group.x) * WORKGROUP + invocation;
    if pixel >= picture.width * picture.height {
        return;
    }
    let at = vec2u(pixel % picture.width, pixel / picture.width);
    let names = drawn[at.y * picture.row + at.x];
    if names.x == NO_INDEX {
        points[pixel] = SeenPoint(vec3f(0.0), SEES_NOTHING, vec3f(0.0), 0u, vec3f(0.0), 0u);
        return;
    }
    // `View::ray`.
    let middle = vec2f(at) + 0.5;
    let across = (2.0 * middle.x / f32(picture.width) - 1.0) * picture.half_width;
    let upwards = (1.0 - 2.0 * middle.y / f32(picture.height)) * picture.half_height;
    let direction = normalize(picture.right * across + picture.up * upwards - picture.back);
    // Where the card sees the triangle: corners are moved by a 512th of a pixel at most, and what is seen is off by as much, far less than
    // light changes over.
    let surface = surface_at(names.x, names.y, bitcast<f32>(names.z), bitcast<f32>(names.w), direction);
    let facing = facing_towards(-direction, surface.point.position, surface.frame.n, surface.point.n_geo);
    let sees = select(SEES_OTHER, SEES_DIFFUSE, has_diffuse(surface.bsdf));
    points[pixel] = SeenPoint(facing.position, sees, facing.normal, 0u, facing.n_geo, 0u);
}
