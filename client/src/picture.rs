//! Pictures: from the payload of a binary message to pixels, and from tiles to a whole.
//!
//! Pure (bytes in, pixels out); no egui, no sockets. Nothing a server sends may allocate more than [`SIDE_MAX`]² pixels
//! or panic.

use crate::tone_map::Display;
use image::{ImageFormat, ImageReader};
use lumicast_protocol::{FrameError, FrameHeader, PayloadCodec, PayloadKind};
use std::io::Cursor;

/// Widest and highest picture this viewer shows, in pixels: graphics cards of ten years ago take textures of this side.
pub const SIDE_MAX: u16 = 8192;
/// What a decoder may allocate beside the picture itself: row buffers and tables.
const DECODER_EXTRA_BYTES: u64 = 16 << 20;

/// Why a binary message became no picture.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PictureError {
    /// The header is not one.
    #[error(transparent)]
    Header(#[from] FrameError),
    /// Larger than this program shows.
    #[error("a picture of {}×{} pixels came; this viewer shows up to {SIDE_MAX}×{SIDE_MAX}", size[0], size[1])]
    TooLarge {
        /// Width and height.
        size: [u16; 2],
    },
    /// The decoder refused it.
    #[error("a {codec} picture cannot be decoded: {reason}")]
    Decode {
        /// JPEG or PNG.
        codec: &'static str,
        /// The decoder's words.
        reason: String,
    },
    /// Header and payload disagree.
    #[error("a frame header announces {}×{} pixels, the picture has {}×{}", announced[0], announced[1], found[0], found[1])]
    Size {
        /// By the header.
        announced: [u16; 2],
        /// In the payload.
        found: [u32; 2],
    },
}

/// Pixels, rows from top to bottom, three channels.
#[derive(Debug, Clone, PartialEq)]
pub enum Pixels {
    /// `[h × w × 3]`, ready to show.
    Srgb(Vec<u8>),
    /// `[h × w × 3]`, linear radiance W/(m² sr).
    Radiance(Vec<f32>),
}

/// A decoded binary message.
#[derive(Debug, Clone, PartialEq)]
pub struct Decoded {
    /// All of the header.
    pub header: FrameHeader,
    /// `None` for a payload that is no picture (a light-map delta): acknowledged and ignored.
    pub pixels: Option<Pixels>,
    /// Of the whole message.
    pub message_bytes: usize,
}

/// Reads a binary message.
pub fn decode(message: &[u8]) -> Result<Decoded, PictureError> {
    let (header, payload) = FrameHeader::decode(message)?;
    let decoded = |pixels| Decoded { header, pixels, message_bytes: message.len() };
    if header.kind == PayloadKind::LightMapDelta {
        return Ok(decoded(None));
    }
    if header.full_size.iter().any(|side| *side > SIDE_MAX) {
        return Err(PictureError::TooLarge { size: header.full_size });
    }
    let pixels = match header.codec {
        PayloadCodec::Jpeg => Pixels::Srgb(decode_image(&header, payload, ImageFormat::Jpeg, "JPEG")?),
        PayloadCodec::Png => Pixels::Srgb(decode_image(&header, payload, ImageFormat::Png, "PNG")?),
        PayloadCodec::Float => {
            let (numbers, _) = payload.as_chunks::<4>();
            Pixels::Radiance(numbers.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect())
        }
    };
    Ok(decoded(Some(pixels)))
}

/// The frame number of a message that could not be decoded, so that it can be acknowledged all the same: a viewer that
/// kept silent would get no more pictures.
pub fn frame_number(message: &[u8]) -> Option<u64> {
    FrameHeader::decode(message).ok().map(|(header, _)| header.frame)
}

fn decode_image(
    header: &FrameHeader,
    payload: &[u8],
    format: ImageFormat,
    codec: &'static str,
) -> Result<Vec<u8>, PictureError> {
    let refused = |error: image::ImageError| PictureError::Decode { codec, reason: error.to_string() };
    let [width, height] = header.size.map(u32::from);
    let found = ImageReader::with_format(Cursor::new(payload), format).into_dimensions().map_err(refused)?;
    // Before decoding: the payload's own size decides what is allocated.
    if found != (width, height) {
        return Err(PictureError::Size { announced: header.size, found: [found.0, found.1] });
    }
    let mut reader = ImageReader::with_format(Cursor::new(payload), format);
    let mut limits = image::Limits::default();
    limits.max_image_width = Some(width);
    limits.max_image_height = Some(height);
    // Up to four channels of 16 bits, and the same again for conversion.
    limits.max_alloc = Some(16 * u64::from(width) * u64::from(height) + DECODER_EXTRA_BYTES);
    reader.limits(limits);
    Ok(reader.decode().map_err(refused)?.into_rgb8().into_raw())
}

/// The picture on show: the last frame, with the tiles that came after it.
#[derive(Debug, Clone, PartialEq)]
pub struct Canvas {
    size: [usize; 2],
    full_size: [usize; 2],
    pixels: Pixels,
}

impl Canvas {
    /// Width and height of the pixels held; smaller than asked while the camera moves on a slow machine.
    pub fn size(&self) -> [usize; 2] {
        self.size
    }

    /// Width and height that were asked for: the shape in which it is shown.
    pub fn full_size(&self) -> [usize; 2] {
        self.full_size
    }

    /// Whether exposure and tone map are this side's business.
    pub fn is_radiance(&self) -> bool {
        matches!(self.pixels, Pixels::Radiance(_))
    }

    /// The canvas after a message: a frame replaces it, a tile is laid over it.
    pub fn after(before: Option<Self>, header: &FrameHeader, pixels: Pixels) -> Self {
        let [size, full_size, offset] =
            [header.size, header.full_size, header.offset].map(|pair| pair.map(usize::from));
        if header.kind == PayloadKind::Frame {
            return Self { size, full_size, pixels };
        }
        let mut canvas = Self::enlarged(before, full_size, &pixels);
        match (&mut canvas.pixels, &pixels) {
            (Pixels::Srgb(to), Pixels::Srgb(tile)) => paste(to, full_size[0], tile, size, offset),
            (Pixels::Radiance(to), Pixels::Radiance(tile)) => paste(to, full_size[0], tile, size, offset),
            // `enlarged` gave it the tile's kind.
            _ => {}
        }
        canvas
    }

    /// A canvas of full size in the kind of `like`: the old picture scaled up, or black where it is of no use.
    fn enlarged(before: Option<Self>, full_size: [usize; 2], like: &Pixels) -> Self {
        let count = full_size[0] * full_size[1] * 3;
        let pixels = match (before, like) {
            (Some(old), _) if old.size == full_size && same_kind(&old.pixels, like) => old.pixels,
            (Some(Self { size, pixels: Pixels::Srgb(old), .. }), Pixels::Srgb(_)) => {
                Pixels::Srgb(nearest(&old, size, full_size))
            }
            (Some(Self { size, pixels: Pixels::Radiance(old), .. }), Pixels::Radiance(_)) => {
                Pixels::Radiance(nearest(&old, size, full_size))
            }
            (_, Pixels::Srgb(_)) => Pixels::Srgb(vec![0; count]),
            (_, Pixels::Radiance(_)) => Pixels::Radiance(vec![0.0; count]),
        };
        Self { size: full_size, full_size, pixels }
    }

    /// `[h × w × 3]` sRGB bytes; `display` is applied where the picture is radiance.
    pub fn to_srgb(&self, display: &Display) -> std::borrow::Cow<'_, [u8]> {
        match &self.pixels {
            Pixels::Srgb(bytes) => bytes.into(),
            Pixels::Radiance(radiance) => {
                let (colours, _) = radiance.as_chunks::<3>();
                colours.iter().flat_map(|colour| display.show(*colour)).collect::<Vec<u8>>().into()
            }
        }
    }
}

fn same_kind(a: &Pixels, b: &Pixels) -> bool {
    std::mem::discriminant(a) == std::mem::discriminant(b)
}

/// Scales `[h × w × 3]` by repeating pixels: it stands for a moment under tiles that are on their way.
fn nearest<T: Copy>(from: &[T], size: [usize; 2], full_size: [usize; 2]) -> Vec<T> {
    let mut to = Vec::with_capacity(full_size[0] * full_size[1] * 3);
    for y in 0..full_size[1] {
        let row = y * size[1] / full_size[1] * size[0];
        for x in 0..full_size[0] {
            let pixel = (row + x * size[0] / full_size[0]) * 3;
            to.extend_from_slice(&from[pixel..pixel + 3]);
        }
    }
    to
}

/// Lays a tile over a picture that it fits into: `FrameHeader::decode` has checked that.
fn paste<T: Copy>(to: &mut [T], to_width: usize, tile: &[T], size: [usize; 2], offset: [usize; 2]) {
    for (row, line) in tile.chunks_exact(size[0] * 3).enumerate() {
        let start = ((offset[1] + row) * to_width + offset[0]) * 3;
        to[start..start + line.len()].copy_from_slice(line);
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use lumicast_protocol::ToneMap;

    pub(crate) fn header(size: [u16; 2], codec: PayloadCodec) -> FrameHeader {
        FrameHeader {
            kind: PayloadKind::Frame,
            codec,
            converged: false,
            first_from_stamp: true,
            revision: 1,
            frame: 1,
            camera_stamp: 1,
            size,
            full_size: size,
            offset: [0, 0],
            error: Some(0.25),
            samples: 4,
            age_us: 1000,
        }
    }

    fn encoded(size: [u16; 2], rgb: [u8; 3], format: ImageFormat) -> Vec<u8> {
        let picture = image::RgbImage::from_pixel(size[0].into(), size[1].into(), image::Rgb(rgb));
        let mut bytes = Cursor::new(Vec::new());
        picture.write_to(&mut bytes, format).unwrap();
        bytes.into_inner()
    }

    #[test]
    fn every_codec_comes_back_as_the_colour_that_was_sent() {
        let display = Display::new(ToneMap::Linear, 0.0);
        let radiance: Vec<u8> = [1.0f32, 0.0, 0.5].repeat(6).iter().flat_map(|v| v.to_le_bytes()).collect();
        for (codec, payload) in [
            (PayloadCodec::Jpeg, encoded([3, 2], [255, 0, 188], ImageFormat::Jpeg)),
            (PayloadCodec::Png, encoded([3, 2], [255, 0, 188], ImageFormat::Png)),
            (PayloadCodec::Float, radiance),
        ] {
            let message = header([3, 2], codec).message(&payload).unwrap();
            let decoded = decode(&message).unwrap();
            let canvas = Canvas::after(None, &decoded.header, decoded.pixels.unwrap());
            let srgb = canvas.to_srgb(&display);
            assert_eq!(srgb.len(), 18);
            for (channel, expected) in srgb.iter().zip([255u8, 0, 188].into_iter().cycle()) {
                // JPEG rounds in YCbCr; 3 codes hold that for a flat picture.
                assert!(channel.abs_diff(expected) <= 3, "{codec:?}: {srgb:?}");
            }
        }
    }

    #[test]
    fn hostile_messages_are_refused_with_a_reason_and_without_a_huge_allocation() {
        let png = encoded([3, 2], [9, 9, 9], ImageFormat::Png);
        // An honest header before a picture that claims another size.
        let lying = header([4, 2], PayloadCodec::Png).message(&png).unwrap();
        assert!(matches!(decode(&lying), Err(PictureError::Size { found: [3, 2], .. })));
        // A header of 65535² pixels: 12 GiB if it were believed.
        let huge = header([65535, 65535], PayloadCodec::Png).message(&png).unwrap();
        assert!(matches!(decode(&huge), Err(PictureError::TooLarge { .. })));
        // The same claim inside a PNG's own header.
        let mut bomb = png.clone();
        bomb[16..24].copy_from_slice(&[0, 0, 255, 255, 0, 0, 255, 255]);
        let bomb = header([3, 2], PayloadCodec::Png).message(&bomb).unwrap();
        assert!(decode(&bomb).is_err());
        for broken in [&b""[..], b"\xff\xd8\xff\xe0", b"not a picture", &png[..png.len() / 2]] {
            for codec in [PayloadCodec::Jpeg, PayloadCodec::Png] {
                let message = header([3, 2], codec).message(broken).unwrap();
                assert!(matches!(decode(&message), Err(PictureError::Decode { .. })), "{broken:?}");
                assert_eq!(frame_number(&message), Some(1));
            }
        }
        assert!(matches!(decode(b"LCF1"), Err(PictureError::Header(_))));
    }

    #[test]
    fn no_cut_or_bit_flip_of_a_message_panics() {
        for (codec, format) in
            [(PayloadCodec::Jpeg, ImageFormat::Jpeg), (PayloadCodec::Png, ImageFormat::Png)]
        {
            let message = header([5, 4], codec).message(&encoded([5, 4], [200, 30, 90], format)).unwrap();
            for end in 0..message.len() {
                let _ = decode(&message[..end]);
            }
            for bit in 0..message.len() * 8 {
                let mut flipped = message.clone();
                flipped[bit / 8] ^= 1 << (bit % 8);
                if let Ok(Decoded { header, pixels: Some(pixels), .. }) = decode(&flipped) {
                    Canvas::after(None, &header, pixels);
                }
            }
        }
    }

    #[test]
    fn tiles_are_laid_over_the_picture_at_full_size() {
        let small =
            Canvas::after(None, &header([2, 1], PayloadCodec::Png), Pixels::Srgb(vec![1, 1, 1, 2, 2, 2]));
        let mut tile = header([2, 1], PayloadCodec::Png);
        (tile.kind, tile.full_size, tile.offset) = (PayloadKind::Tile, [4, 2], [2, 1]);
        let canvas = Canvas::after(Some(small), &tile, Pixels::Srgb(vec![9; 6]));
        let Pixels::Srgb(bytes) = &canvas.pixels else { panic!("the kind changed") };
        let grey: Vec<u8> = bytes.chunks(3).map(|pixel| pixel[0]).collect();
        assert_eq!(grey, [1, 1, 2, 2, 1, 1, 9, 9]);
        assert_eq!((canvas.size(), canvas.full_size()), ([4, 2], [4, 2]));
        // A tile of another kind than the picture: the rest is black until it comes.
        let canvas = Canvas::after(Some(canvas), &tile, Pixels::Radiance(vec![1.0; 6]));
        assert!(canvas.is_radiance());
    }
}
