//! Pictures of a picture: as people see it, and where its error sits.

use lumicast_engine::{
    film::{Display, PictureSize, ToneMap},
    math::Rgb,
};

use super::ReportError;
use crate::images::{JpegQuality, jpeg, write_file};

/// Of JPEG files: a report holds many pictures.
const QUALITY: u8 = 85;

/// Colours of no error and of as much as the brightness that it is relative to, and between: from black over blue and orange
/// to white, also for people who see few colours.
const RAMP: [[f32; 3]; 5] =
    [[0.0, 0.0, 0.0], [0.0, 90.0, 160.0], [160.0, 80.0, 130.0], [240.0, 150.0, 30.0], [255.0, 255.0, 255.0]];

/// Writes a picture as its reference would be exposed: its mean is a middle grey.
pub(super) fn write_picture(
    path: &std::path::Path,
    size: PictureSize,
    radiance: &[Rgb],
    mean: f64,
) -> Result<(), ReportError> {
    let exposure_ev = (0.18 / mean.max(1e-30)).log2().clamp(-64.0, 64.0) as f32;
    write(path, size, &Display::new(ToneMap::AgX, exposure_ev).show_all(radiance))
}

/// Writes how far a picture is off in every pixel, in shares of its brightness: the square root of what relMSE is the mean of.
pub(super) fn write_difference(
    path: &std::path::Path,
    size: PictureSize,
    [radiance, reference]: [&[Rgb]; 2],
    mean: f64,
) -> Result<(), ReportError> {
    let floor = (0.01 * mean * mean) as f32;
    let rgb8: Vec<u8> = radiance
        .iter()
        .zip(reference)
        .flat_map(|(test, truth)| {
            let square = |at: usize| (test[at] - truth[at]).powi(2) / (truth[at].powi(2) + floor);
            colour_of(((square(0) + square(1) + square(2)) / 3.0).sqrt())
        })
        .collect();
    write(path, size, &rgb8)
}

/// - `share`: 0 is black, 1 and more, and what is no number, white
fn colour_of(share: f32) -> [u8; 3] {
    let last = RAMP.len() - 1;
    let at = if share.is_nan() { 1.0 } else { share.clamp(0.0, 1.0) } * last as f32;
    let below = (at as usize).min(last - 1);
    let between = at - below as f32;
    std::array::from_fn(|channel| {
        (RAMP[below][channel] * (1.0 - between) + RAMP[below + 1][channel] * between).round() as u8
    })
}

fn write(path: &std::path::Path, size: PictureSize, rgb8: &[u8]) -> Result<(), ReportError> {
    let jpeg = jpeg(rgb8, size, JpegQuality::clamped(QUALITY))
        .map_err(|error| ReportError::Text { what: "a picture", reason: error.to_string() })?;
    Ok(write_file(path, &jpeg)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The ramp runs from black to white and takes whatever comes.
    #[test]
    fn every_error_has_a_colour() {
        assert_eq!(colour_of(0.0), [0, 0, 0]);
        assert_eq!(colour_of(0.25), [0, 90, 160]);
        for share in [1.0, 7.0, f32::INFINITY, f32::NAN] {
            assert_eq!(colour_of(share), [255, 255, 255]);
        }
        assert_eq!(colour_of(-1.0), [0, 0, 0]);
    }
}
