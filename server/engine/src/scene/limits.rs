//! How large a scene may be. Every number is a field of the server's config; these are the defaults.

/// Upper bounds on what a scene holds, checked by the builder on every change.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SceneLimits {
    /// Vertices over all meshes. Default 20 million: about 1 GB with normals and texture coordinates.
    pub vertices_max: u64,
    /// Triangles over all meshes, each counted once. Default 20 million.
    pub triangles_max: u64,
    /// Triangles over all instances that emit light. Default 2 million: each becomes a light, and those with an uneven
    /// picture together up to 65,536 more.
    pub emissive_triangles_max: u64,
    /// Texels over all textures. Default 268 million (1 GiB of RGBA8): four 8192² images.
    pub texels_max: u64,
    /// Nodes. Default 100,000.
    pub nodes_max: usize,
    /// Depth of the node hierarchy. Default 64.
    pub node_depth_max: usize,
    /// Materials. Default 10,000.
    pub materials_max: usize,
    /// Punctual lights. Default 10,000.
    pub lights_max: usize,
    /// Cameras. Default 1,000.
    pub cameras_max: usize,
    /// Warnings kept; further ones are counted in one last line. Default 200.
    pub warnings_max: usize,
    /// Largest coordinate in metres, mesh or world. Default 1e9: beyond it f32 rays lose a millimetre's meaning anyway.
    pub coordinate_max_m: f64,
}

impl Default for SceneLimits {
    fn default() -> SceneLimits {
        SceneLimits {
            vertices_max: 20_000_000,
            triangles_max: 20_000_000,
            emissive_triangles_max: 2_000_000,
            texels_max: 268_435_456,
            nodes_max: 100_000,
            node_depth_max: 64,
            materials_max: 10_000,
            lights_max: 10_000,
            cameras_max: 1_000,
            warnings_max: 200,
            coordinate_max_m: 1e9,
        }
    }
}
