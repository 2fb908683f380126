// A picture that records of irradiance are splatted onto: `technique/path/gpu/splats.rs`. Its steps and draws bind `picture: Picture`.

/// The camera, and what is done now.
struct Picture {
    /// The eye, in render space.
    origin: vec3f,
    /// Half of what is seen at distance 1.
    half_width: f32,
    right: vec3f,
    half_height: f32,
    up: vec3f,
    width: u32,
    back: vec3f,
    height: u32,
    /// Pixels of a row of what is copied from targets: as many as `width`, or a few more.
    row: u32,
    /// The cache whose records are splatted, 0 the finest.
    cache: u32,
    padding_0: u32,
    padding_1: u32,
}

/// What the middle of a pixel sees.
struct SeenPoint {
    /// In render space.
    position: vec3f,
    /// `SEES_…`.
    sees: u32,
    /// Shading normal on the side that is seen.
    normal: vec3f,
    padding_0: u32,
    /// Normal of the triangle on that side.
    n_geo: vec3f,
    padding_1: u32,
}

const SEES_NOTHING: u32 = 0u;
/// A surface that scatters nothing diffusely: a mirror, clear glass, black.
const SEES_OTHER: u32 = 1u;
const SEES_DIFFUSE: u32 = 2u;
