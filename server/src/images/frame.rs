//! Pictures of display values or floats as bytes, for streams and for PNG files.

use image::{
    ExtendedColorType, ImageEncoder,
    codecs::png::{CompressionType, FilterType, PngEncoder},
};
use lumicast_engine::{film::PictureSize, math::Rgb};

/// A picture that could not be turned into bytes.
#[derive(Debug, thiserror::Error)]
#[error("encoding a picture of {width}×{height} as {format}: {reason}")]
pub struct EncodeError {
    /// Name of the format.
    pub format: &'static str,
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// What went wrong.
    pub reason: String,
}

impl EncodeError {
    pub(super) fn new(format: &'static str, size: PictureSize, reason: impl ToString) -> EncodeError {
        EncodeError { format, width: size.width(), height: size.height(), reason: reason.to_string() }
    }
}

/// PNG of sRGB bytes `[h × w × 3]`, encoded quickly: for streams.
pub fn png_fast(rgb8: &[u8], size: PictureSize) -> Result<Vec<u8>, EncodeError> {
    png(rgb8, size, CompressionType::Fast)
}

/// PNG of sRGB bytes `[h × w × 3]`, encoded small: for files.
pub fn png_small(rgb8: &[u8], size: PictureSize) -> Result<Vec<u8>, EncodeError> {
    png(rgb8, size, CompressionType::Default)
}

fn png(rgb8: &[u8], size: PictureSize, compression: CompressionType) -> Result<Vec<u8>, EncodeError> {
    let fail = |reason: String| EncodeError::new("PNG", size, reason);
    check_length(rgb8, size).map_err(fail)?;
    let mut bytes = Vec::with_capacity(rgb8.len() / 2);
    PngEncoder::new_with_quality(&mut bytes, compression, FilterType::Adaptive)
        .write_image(rgb8, size.width(), size.height(), ExtendedColorType::Rgb8)
        .map_err(|error| fail(error.to_string()))?;
    Ok(bytes)
}

/// Errors: what is wrong about it.
pub(super) fn check_length(rgb8: &[u8], size: PictureSize) -> Result<(), String> {
    let expected = size.pixel_count() * 3;
    if rgb8.len() == expected { Ok(()) } else { Err(format!("{} bytes instead of {expected}", rgb8.len())) }
}

/// Linear radiance as little-endian floats, r g b per pixel.
pub fn rgb_f32_le(radiance: &[Rgb]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(radiance.len() * 12);
    for channel in radiance.iter().flat_map(|colour| colour.to_array()) {
        bytes.extend_from_slice(&channel.to_le_bytes());
    }
    bytes
}

#[cfg(test)]
mod tests {
    use super::{
        super::{JpegQuality, jpeg},
        *,
    };

    fn gradient(width: u32, height: u32) -> (Vec<u8>, PictureSize) {
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        let bytes = pixels.flat_map(|(x, y)| [(x * 2) as u8, (y * 3) as u8, 128]).collect();
        (bytes, PictureSize::new(width, height).unwrap())
    }

    /// PNG loses nothing, at every size.
    #[test]
    fn png_gives_back_the_same_bytes() {
        for (width, height) in [(1, 1), (17, 5), (100, 60)] {
            let (picture, size) = gradient(width, height);
            for bytes in [png_fast(&picture, size).unwrap(), png_small(&picture, size).unwrap()] {
                let decoded = image::load_from_memory(&bytes).unwrap().into_rgb8();
                assert_eq!((decoded.dimensions(), decoded.as_raw()), ((width, height), &picture));
            }
        }
    }

    /// Bytes that are no picture of that size are refused, never read past their end.
    #[test]
    fn wrong_lengths_are_refused() {
        let (picture, size) = gradient(10, 10);
        for bytes in [&picture[1..], &[]] {
            assert!(jpeg(bytes, size, JpegQuality::FILE).is_err());
            let error = png_fast(bytes, size).unwrap_err().to_string();
            assert!(error.contains("10×10") && error.contains("300"), "{error}");
        }
    }

    /// Floats keep every bit, in the documented order.
    #[test]
    fn floats_are_little_endian_in_channel_order() {
        let bytes = rgb_f32_le(&[Rgb::new(1.0, -0.5, 1e20), Rgb::splat(0.1)]);
        assert_eq!(bytes.len(), 24);
        let value = |index: usize| f32::from_le_bytes(bytes[index * 4..][..4].try_into().unwrap());
        assert_eq!([value(0), value(1), value(2), value(5)], [1.0, -0.5, 1e20, 0.1]);
    }
}
