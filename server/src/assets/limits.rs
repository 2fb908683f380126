//! How large a file may be. Every number is a field of the server's config; these are the defaults.

use lumicast_engine::scene::SceneLimits;

/// Upper bounds on what a scene file may make the server read or hold, checked before memory is taken.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AssetLimits {
    /// Bytes of the scene file itself. Default 2 GiB: the largest GLB that common exporters write.
    pub file_bytes_max: u64,
    /// Bytes of everything the file refers to: files beside it and decoded data URIs, together.
    /// Default 2 GiB, as for the file.
    pub buffers_bytes_max: u64,
    /// Bytes of a glTF file's JSON, data URIs included. Default 512 MiB: embedded images fit,
    /// and the text, which is read twice, stays small beside the scene.
    pub json_bytes_max: u64,
    /// Values in a glTF file's JSON. Default 4 million: 100,000 nodes with full matrices need 2.5 million.
    /// A parsed value takes up to some 100 bytes (nodes and materials, which take more, are counted first),
    /// so this bounds the memory that hostile JSON can ask for.
    pub json_values_max: u64,
    /// Texels of one image, known from its header. Default 67 million (8192²): 256 MiB decoded.
    pub image_pixels_max: u64,
    /// Elements of one accessor. Default 60 million: the corners of the default 20 million triangles.
    pub accessor_elements_max: u64,
    /// What the scene as a whole may hold.
    pub scene: SceneLimits,
}

impl AssetLimits {
    /// For what this program has written itself: only what no scene may have, coordinates beyond reason, is refused.
    pub fn none() -> AssetLimits {
        AssetLimits {
            file_bytes_max: u64::MAX,
            buffers_bytes_max: u64::MAX,
            json_bytes_max: u64::MAX,
            json_values_max: u64::MAX,
            image_pixels_max: u64::MAX,
            accessor_elements_max: u64::MAX,
            scene: SceneLimits {
                vertices_max: u64::MAX,
                triangles_max: u64::MAX,
                emissive_triangles_max: u64::MAX,
                texels_max: u64::MAX,
                nodes_max: usize::MAX,
                node_depth_max: usize::MAX,
                materials_max: usize::MAX,
                lights_max: usize::MAX,
                cameras_max: usize::MAX,
                ..SceneLimits::default()
            },
        }
    }
}

impl Default for AssetLimits {
    fn default() -> AssetLimits {
        AssetLimits {
            file_bytes_max: 2 << 30,
            buffers_bytes_max: 2 << 30,
            json_bytes_max: 512 << 20,
            json_values_max: 4_000_000,
            image_pixels_max: 67_108_864,
            accessor_elements_max: 60_000_000,
            scene: SceneLimits::default(),
        }
    }
}
