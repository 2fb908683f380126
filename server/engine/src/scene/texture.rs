//! Textures: texels, and how a material looks them up.

use glam::Affine2;

use super::Id;

/// Texels, rows top to bottom.
#[derive(Clone, Debug, PartialEq)]
pub enum Texels {
    /// `[h × w]` bytes as in the file; the slot says whether RGB is sRGB-encoded.
    Rgba8(Vec<[u8; 4]>),
    /// `[h × w]` linear floats.
    Rgba32F(Vec<[f32; 4]>),
}

/// An image.
#[derive(Clone, Debug, PartialEq)]
pub struct Texture {
    /// Texels in a row, at least 1.
    pub width: u32,
    /// Rows, at least 1.
    pub height: u32,
    /// `width × height` texels.
    pub texels: Texels,
}

impl Texture {
    /// Number of texels.
    pub fn texel_count(&self) -> usize {
        match &self.texels {
            Texels::Rgba8(texels) => texels.len(),
            Texels::Rgba32F(texels) => texels.len(),
        }
    }

    /// Memory of the texels.
    pub fn bytes(&self) -> usize {
        match &self.texels {
            Texels::Rgba8(texels) => texels.len() * 4,
            Texels::Rgba32F(texels) => texels.len() * 16,
        }
    }
}

/// What a coordinate outside [0, 1] means.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Wrap {
    /// The picture repeats.
    #[default]
    Repeat,
    /// Every second repeat is mirrored.
    Mirror,
    /// The border goes on.
    Clamp,
}

/// How texels are combined.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Filter {
    /// Four nearest texels, linear in each axis, decoded to linear first.
    #[default]
    Bilinear,
    /// The texel that holds the point.
    Nearest,
}

/// A material's use of a texture.
#[derive(Clone, Debug, PartialEq)]
pub struct TextureRef {
    /// The texture.
    pub texture: Id,
    /// Texture coordinate set, 0 or 1.
    pub texcoord_set: u8,
    /// From the mesh's coordinates to the picture's (`KHR_texture_transform`), finite.
    pub uv_transform: Affine2,
    /// Wrap along u.
    pub wrap_u: Wrap,
    /// Wrap along v.
    pub wrap_v: Wrap,
    /// Filter.
    pub filter: Filter,
}

impl TextureRef {
    /// Plain use of `texture`: set 0, repeat, bilinear.
    pub fn new(texture: Id) -> TextureRef {
        TextureRef {
            texture,
            texcoord_set: 0,
            uv_transform: Affine2::IDENTITY,
            wrap_u: Wrap::Repeat,
            wrap_v: Wrap::Repeat,
            filter: Filter::Bilinear,
        }
    }
}
