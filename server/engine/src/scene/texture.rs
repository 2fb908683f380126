//! Textures: texels, and how a material looks them up.

use std::sync::LazyLock;

use glam::{Affine2, Vec2, Vec4};

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
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
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
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
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

/// sRGB byte → linear.
static LINEAR_FROM_SRGB: LazyLock<[f32; 256]> = LazyLock::new(|| {
    std::array::from_fn(|byte| {
        let c = byte as f32 / 255.0;
        if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }
    })
});

/// Linear values of sRGB bytes: what [`Texture::texel`] looks up.
pub fn linear_from_srgb() -> &'static [f32; 256] {
    &LINEAR_FROM_SRGB
}

/// What the RGB bytes of a texture stand for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Encoding {
    /// Colour, sRGB-encoded.
    Srgb,
    /// Numbers.
    Linear,
}

impl Texture {
    /// The texel at column `x`, row `y`, decoded to linear.
    pub fn texel(&self, x: u32, y: u32, encoding: Encoding) -> Vec4 {
        let index = y as usize * self.width as usize + x as usize;
        match (&self.texels, encoding) {
            (Texels::Rgba32F(texels), _) => Vec4::from(texels[index]),
            (Texels::Rgba8(texels), Encoding::Linear) => {
                Vec4::from(texels[index].map(f32::from)) * (1.0 / 255.0)
            }
            (Texels::Rgba8(texels), Encoding::Srgb) => {
                let [r, g, b, a] = texels[index];
                let linear = |byte: u8| LINEAR_FROM_SRGB[byte as usize];
                Vec4::new(linear(r), linear(g), linear(b), f32::from(a) * (1.0 / 255.0))
            }
        }
    }
}

impl TextureRef {
    /// The picture's value at mesh coordinates `uv`, linear RGBA. v = 0 is the top row, as in glTF.
    pub fn sample(&self, texture: &Texture, uv: Vec2, encoding: Encoding) -> Vec4 {
        let uv = self.uv_transform.transform_point2(uv);
        // Beyond a billion repeats f32 has no fraction left: show the first texel rather than overflow.
        let uv = if uv.abs().cmplt(Vec2::splat(1e9)).all() { uv } else { Vec2::ZERO };
        let (width, height) = (texture.width, texture.height);
        if self.filter == Filter::Nearest {
            let at =
                |coordinate: f32, size: u32, wrap| wrapped((coordinate * size as f32).floor(), size, wrap);
            return texture.texel(at(uv.x, width, self.wrap_u), at(uv.y, height, self.wrap_v), encoding);
        }
        // Texel centres lie at half-integers.
        let (x, y) = (uv.x * width as f32 - 0.5, uv.y * height as f32 - 0.5);
        let (fx, fy) = (x - x.floor(), y - y.floor());
        let columns = [0.0, 1.0].map(|step| wrapped(x.floor() + step, width, self.wrap_u));
        let rows = [0.0, 1.0].map(|step| wrapped(y.floor() + step, height, self.wrap_v));
        let row = |y| texture.texel(columns[0], y, encoding).lerp(texture.texel(columns[1], y, encoding), fx);
        row(rows[0]).lerp(row(rows[1]), fy)
    }
}

/// Whole texel coordinate → column or row.
fn wrapped(coordinate: f32, size: u32, wrap: Wrap) -> u32 {
    // i64 holds every whole f32 that a finite coordinate below 2^63 makes; beyond, the cast saturates.
    let (i, n) = (coordinate as i64, i64::from(size));
    let index = match wrap {
        Wrap::Repeat => i.rem_euclid(n),
        Wrap::Clamp => i.clamp(0, n - 1),
        Wrap::Mirror => {
            let folded = i.rem_euclid(2 * n);
            folded.min(2 * n - 1 - folded)
        }
    };
    index as u32
}

#[cfg(test)]
mod tests {
    use super::*;

    fn checks() -> Texture {
        let texels = vec![[255, 0, 0, 255], [0, 255, 0, 255], [0, 0, 255, 128], [0, 0, 0, 0]];
        Texture { width: 2, height: 2, texels: Texels::Rgba8(texels) }
    }

    /// Texel centres give the texel, midpoints the mean, on each wrap mode.
    #[test]
    fn bilinear_lookup_interpolates_between_texel_centres() {
        let texture = checks();
        let mut reference = TextureRef::new(Id::sanitised("t", "t"));
        let at = |reference: &TextureRef, u: f32, v: f32| {
            reference.sample(&texture, Vec2::new(u, v), Encoding::Linear)
        };
        assert_eq!(at(&reference, 0.25, 0.25), Vec4::new(1.0, 0.0, 0.0, 1.0));
        assert_eq!(at(&reference, 0.75, 0.25), Vec4::new(0.0, 1.0, 0.0, 1.0));
        assert_eq!(at(&reference, 1.25, -0.75), Vec4::new(1.0, 0.0, 0.0, 1.0));
        assert_eq!(at(&reference, 0.5, 0.25), Vec4::new(0.5, 0.5, 0.0, 1.0));
        reference.wrap_u = Wrap::Clamp;
        assert_eq!(at(&reference, 7.0, 0.25), Vec4::new(0.0, 1.0, 0.0, 1.0));
        reference.wrap_u = Wrap::Mirror;
        assert_eq!(at(&reference, 1.25, 0.25), Vec4::new(0.0, 1.0, 0.0, 1.0));
        assert_eq!(at(&reference, 1.75, 0.25), Vec4::new(1.0, 0.0, 0.0, 1.0));
    }

    /// Coordinates of any size stay inside the picture.
    #[test]
    fn far_away_coordinates_are_answered() {
        let texture = checks();
        for wrap in [Wrap::Repeat, Wrap::Mirror, Wrap::Clamp] {
            let reference =
                TextureRef { wrap_u: wrap, wrap_v: wrap, ..TextureRef::new(Id::sanitised("t", "t")) };
            for coordinate in [1e9, -1e9, 1e30, -1e30, f32::MAX, f32::MIN, f32::NAN, f32::INFINITY] {
                assert!(reference.sample(&texture, Vec2::splat(coordinate), Encoding::Srgb).is_finite());
            }
            // Finite numbers whose products overflow against each other, in one coordinate alone.
            let mut steep = reference.clone();
            steep.uv_transform.matrix2.x_axis.x = 1e38;
            steep.uv_transform.matrix2.y_axis.x = -1e38;
            assert!(steep.sample(&texture, Vec2::splat(10.0), Encoding::Srgb).is_finite());
        }
    }
}
