//! Pictures as JPEG, by all threads: strips that are packed by themselves and joined to one scan.
//!
//! Between strips stand restart markers, after which decoders begin anew as the strip did [T.81, F.1.1.5.2]: the picture is that of one
//! strip, to the last bit. Strips are as high whatever the threads, and so are the bytes.

use super::{EncodeError, frame::check_length};
use jpeg_encoder::{ColorType, Encoder, SamplingFactor};
use lumicast_engine::film::PictureSize;
use rayon::prelude::*;

/// JPEG quality, 1 (smallest) to 100 (best).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct JpegQuality(u8);

impl JpegQuality {
    /// For pictures on disk.
    pub const FILE: JpegQuality = JpegQuality(95);

    /// The nearest quality that there is.
    pub fn clamped(quality: u8) -> JpegQuality {
        JpegQuality(quality.clamp(1, 100))
    }

    /// The number.
    pub fn value(self) -> u8 {
        self.0
    }

    /// Colour at half resolution below quality 90: it halves the time and a third of the bytes, and what
    /// it loses hides among the blocks. Above, sharp coloured edges are worth their bytes.
    fn sampling(self) -> (SamplingFactor, usize) {
        if self.0 < 90 { (SamplingFactor::F_2_2, 16) } else { (SamplingFactor::F_1_1, 8) }
    }
}

/// Rows of a strip: whole blocks at either sampling. 128 rows of 1920 pixels are packed in some 2 ms.
const STRIP_ROWS: usize = 128;
/// Blocks from one restart to the next at most, as a file can say it. A strip of the widest picture has half of that.
const _: () = assert!(PictureSize::SIDE_MAX as usize / 8 * (STRIP_ROWS / 8) <= u16::MAX as usize);

/// Markers.
const START_OF_FRAME: u8 = 0xc0;
const RESTART: u8 = 0xd0;
const START_OF_SCAN: u8 = 0xda;
const RESTART_INTERVAL: u8 = 0xdd;
/// Bytes of those that begin and end a file.
const MARKER_BYTES: usize = 2;
/// Where the height stands in what follows a frame's marker.
const HEIGHT_AT: usize = 3;

/// JPEG of sRGB bytes `[h × w × 3]`, on the rayon pool that it is called in.
///
/// Errors: bytes of another number, and what the encoder refuses.
pub fn jpeg(rgb8: &[u8], size: PictureSize, quality: JpegQuality) -> Result<Vec<u8>, EncodeError> {
    let fail = |reason: String| EncodeError::new("JPEG", size, reason);
    check_length(rgb8, size).map_err(fail)?;
    let row_bytes = 3 * size.width() as usize;
    let strips: Vec<Vec<u8>> = rgb8
        .par_chunks(STRIP_ROWS * row_bytes)
        .map(|strip| packed(strip, row_bytes, quality))
        .collect::<Result<_, _>>()
        .map_err(fail)?;
    joined(strips, size, quality).ok_or_else(|| fail("the encoder left no scan".into()))
}

/// A strip as a file of its own.
fn packed(strip: &[u8], row_bytes: usize, quality: JpegQuality) -> Result<Vec<u8>, String> {
    // About a quarter of a byte per pixel at common qualities; the vector grows where that is too little.
    let mut bytes = Vec::with_capacity(strip.len() / 12 + 1024);
    let mut encoder = Encoder::new(&mut bytes, quality.0);
    encoder.set_sampling_factor(quality.sampling().0);
    // Sides are at most 16,384, so they fit u16.
    let [width, height] = [row_bytes / 3, strip.len() / row_bytes].map(|side| side as u16);
    encoder.encode(strip, width, height, ColorType::Rgb).map_err(|error| error.to_string())?;
    Ok(bytes)
}

/// One file of all strips; `None` where one is no file with a scan.
fn joined(mut strips: Vec<Vec<u8>>, size: PictureSize, quality: JpegQuality) -> Option<Vec<u8>> {
    if strips.len() < 2 {
        return strips.pop();
    }
    let blocks =
        size.width().div_ceil(quality.sampling().1 as u32) * (STRIP_ROWS / quality.sampling().1) as u32;
    let [interval_high, interval_low] = (blocks as u16).to_be_bytes();
    let mut file = Vec::with_capacity(strips.iter().map(Vec::len).sum());
    for (index, strip) in strips.iter().enumerate() {
        let Head { frame, scan, data } = Head::of(strip)?;
        if index == 0 {
            file.extend_from_slice(&strip[..scan]);
            let height_at = frame + MARKER_BYTES + HEIGHT_AT;
            file.get_mut(height_at..height_at + 2)?.copy_from_slice(&(size.height() as u16).to_be_bytes());
            file.extend([0xff, RESTART_INTERVAL, 0, 4, interval_high, interval_low]);
            file.extend_from_slice(&strip[scan..data]);
        } else {
            file.extend([0xff, RESTART + (index as u8 - 1) % 8]);
        }
        let end = if index + 1 == strips.len() { strip.len() } else { strip.len() - MARKER_BYTES };
        file.extend_from_slice(strip.get(data..end)?);
    }
    Some(file)
}

/// Where things stand in a file: markers of its frame and of its scan, and what the scan holds.
struct Head {
    frame: usize,
    scan: usize,
    data: usize,
}

impl Head {
    fn of(file: &[u8]) -> Option<Head> {
        let (mut at, mut frame) = (MARKER_BYTES, None);
        loop {
            let [0xff, marker, high, low] = *file.get(at..at + 4)?.first_chunk()? else { return None };
            let next = at + MARKER_BYTES + usize::from(u16::from_be_bytes([high, low]));
            match marker {
                START_OF_FRAME => frame = Some(at),
                START_OF_SCAN => return Some(Head { frame: frame?, scan: at, data: next }),
                _ => {}
            }
            at = next;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(width: u32, height: u32) -> (Vec<u8>, PictureSize) {
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        let bytes =
            pixels.flat_map(|(x, y)| [(x * 2) as u8, (y * 3 + x * y / 7) as u8, (x ^ y) as u8]).collect();
        (bytes, PictureSize::new(width, height).unwrap())
    }

    fn decoded(bytes: &[u8]) -> image::RgbImage {
        image::load_from_memory_with_format(bytes, image::ImageFormat::Jpeg).unwrap().into_rgb8()
    }

    /// Strips show what one strip shows, at either sampling and whatever is left for the last.
    #[test]
    fn strips_are_one_picture() {
        for (width, height) in [(1, 1), (33, 128), (33, 129), (100, 300), (257, 1153), (16, 1400)] {
            let (rgb, size) = picture(width, height);
            for quality in [50, 85, 90, 100].map(JpegQuality::clamped) {
                let bytes = jpeg(&rgb, size, quality).unwrap();
                let alone = packed(&rgb, 3 * width as usize, quality).unwrap();
                let (ours, expected) = (decoded(&bytes), decoded(&alone));
                assert_eq!(ours.dimensions(), (width, height));
                assert!(ours == expected, "{width}×{height} at {quality:?}");
                assert_eq!(bytes == alone, height <= 128, "{width}×{height} in strips");
            }
        }
    }

    /// The same bytes on any number of threads.
    #[test]
    fn threads_change_no_byte() {
        let (rgb, size) = picture(320, 700);
        let on = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| jpeg(&rgb, size, JpegQuality::clamped(85)).unwrap())
        };
        assert_eq!(on(1), on(3));
    }

    /// JPEG shows the same picture, and better quality is nearer.
    #[test]
    fn jpeg_gives_back_the_picture_to_its_quality() {
        let pixels = (0..60).flat_map(|y| (0..100).map(move |x| (x, y)));
        let ramp: Vec<u8> = pixels.flat_map(|(x, y)| [(x * 2) as u8, (y * 3) as u8, 128]).collect();
        let size = PictureSize::new(100, 60).unwrap();
        let worst = |quality: u8| {
            let decoded = decoded(&jpeg(&ramp, size, JpegQuality::clamped(quality)).unwrap());
            assert_eq!(decoded.dimensions(), (100, 60));
            decoded.as_raw().iter().zip(&ramp).map(|(a, b)| a.abs_diff(*b)).max().unwrap()
        };
        // A smooth ramp has few high frequencies: a few codes of error, fewer at better quality.
        assert!(worst(100) <= 3, "{}", worst(100));
        assert!(worst(50) <= 24, "{}", worst(50));
    }
}
