// What the sums of a cache's records say in a pixel. Another part binds `picture: Picture`, `answers: array<vec4f>`, irradiance and weight
// of which weight 0 says that no cache so far has answered, and `missing: Missing`.

/// Pixels that lack a record of the finest cache, in no order.
struct Missing {
    count: atomic<u32>,
    pixels: array<u32>,
}

/// - `sum`: of weight times irradiance, and of weights, of all records of the cache
fn answer_by(sum: vec4f, pixel: u32) {
    if sum.w > 0.0 {
        answers[pixel] = vec4f(sum.xyz / sum.w, sum.w);
    } else if picture.cache == 0u {
        missing.pixels[atomicAdd(&missing.count, 1u)] = pixel;
    }
}
