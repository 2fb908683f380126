// What a light without extent sees: pictures of the scene from where it stands, of how near the surface in each texel is.
// `technique/path/shadow_maps.rs` says which light has which.

/// A picture from a light, or, of one that is infinitely far, of what its parallel rays meet. It spans from -1 to 1 to the
/// right and upwards; rows go from top to bottom.
struct ShadowPlane {
    /// Where it looks from, in render space.
    origin: vec3f,
    /// Half of its width, m: at distance 1 where rays part, else as it is.
    half_width: f32,
    right: vec3f,
    half_height: f32,
    up: vec3f,
    /// The distance of nearness 1 where rays part, m, and nearness falls as one over distance; else that of nearness 0, and it
    /// falls evenly.
    reach_m: f32,
    back: vec3f,
    /// 1: rays part.
    is_perspective: u32,
    /// Where its texels begin.
    first_texel: u32,
    /// Texels of a row, and rows.
    side: u32,
    padding_0: u32,
    padding_1: u32,
}
