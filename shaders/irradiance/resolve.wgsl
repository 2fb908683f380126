// What the records of a cache that were added up in pixels say there, and which pixels none of the finest covers.

@group(0) @binding(0) var<uniform> picture: Picture;
@group(0) @binding(1) var<storage, read> points: array<SeenPoint>;
/// Sums of weight times irradiance, and of weights, in rows of `picture.row`.
@group(0) @binding(2) var<storage, read> sums: array<vec4f>;
/// Irradiance and weight; weight 0: no cache so far has answered.
@group(0) @binding(3) var<storage, read_write> answers: array<vec4f>;
@group(0) @binding(4) var<storage, read_write> missing: Missing;

@compute @workgroup_size(WORKGROUP)
fn resolve(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) invocation: u32,
) {
    let pixel = (group.y * groups.x + group.x) * WORKGROUP + invocation;
    if pixel >= picture.width * picture.height {
        return;
    }
    if points[pixel].sees != SEES_DIFFUSE || answers[pixel].w > 0.0 {
        return;
    }
    let sum = sums[pixel / picture.width * picture.row + pixel % picture.width];
    answer_by(sum, pixel);
}
