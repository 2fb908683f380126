//! PNG and JPEG bytes → textures. Sizes are read from the header before any texel is decoded.

use std::io::Cursor;

use image::{DynamicImage, ImageDecoder, ImageReader, Limits};
use lumicast_engine::scene::{Texels, Texture};

/// Columns and rows of a picture, from its header.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::assets) struct Size {
    pub(in crate::assets) width: u32,
    pub(in crate::assets) height: u32,
}

impl Size {
    pub(in crate::assets) fn pixels(self) -> u64 {
        u64::from(self.width) * u64::from(self.height)
    }
}

/// A decoded picture.
#[derive(Debug)]
pub(in crate::assets) struct Picture {
    pub(in crate::assets) texture: Texture,
    /// More than 8 bits a channel were in the file and are lost.
    pub(in crate::assets) was_deeper: bool,
}

/// The size that the header of a PNG or JPEG states.
pub(in crate::assets) fn size(bytes: &[u8]) -> Result<Size, String> {
    let mut limits = Limits::default();
    // Room for the tables and texts in front of the texels, which may be packed.
    limits.max_alloc = Some(64 << 20);
    let (width, height) = decoder(bytes, limits)?.dimensions();
    if width == 0 || height == 0 {
        return Err(format!("is {width}×{height}: a picture has at least one texel"));
    }
    Ok(Size { width, height })
}

/// Decodes a PNG or JPEG whose header says `size`.
pub(in crate::assets) fn decode(bytes: &[u8], size: Size) -> Result<Picture, String> {
    let mut limits = Limits::default();
    limits.max_image_width = Some(size.width);
    limits.max_image_height = Some(size.height);
    // 16 bytes for a texel (the widest format), and a little for the decoder's own rows and tables.
    limits.max_alloc = Some(size.pixels() * 16 + (16 << 20));
    let image = DynamicImage::from_decoder(decoder(bytes, limits)?).map_err(|error| error.to_string())?;
    let was_deeper = image.color().bytes_per_pixel() > image.color().channel_count();
    let rgba = image.into_rgba8();
    let (width, height) = rgba.dimensions();
    let texels = rgba.as_raw().as_chunks::<4>().0.to_vec();
    Ok(Picture { texture: Texture { width, height, texels: Texels::Rgba8(texels) }, was_deeper })
}

fn decoder(bytes: &[u8], limits: Limits) -> Result<impl ImageDecoder + '_, String> {
    let mut reader = ImageReader::new(Cursor::new(bytes));
    reader.limits(limits);
    let reader = reader.with_guessed_format().map_err(|error| error.to_string())?;
    if reader.format().is_none() {
        return Err("is neither PNG nor JPEG".into());
    }
    reader.into_decoder().map_err(|error| error.to_string())
}
