//! Films → packed pictures: JPEG, PNG or float, through exposure and tone map.

use crate::convert;
use crate::images::{self, EncodeError, JpegQuality};
use glam::UVec2;
use lumicast_engine::film::{Display, Picture, PictureSize};
use lumicast_protocol::{Codec, PayloadCodec, Quality};
use std::sync::Arc;

/// Packs the pictures of one viewer. Keeps the tables of its last exposure and tone map: making them takes longer than
/// showing a small picture.
#[derive(Debug, Default)]
pub(super) struct Packer {
    display: Option<(lumicast_protocol::ToneMap, f32, Arc<Display>)>,
}

/// A picture that is packed.
#[derive(Debug, Clone, Copy)]
pub(super) struct Packed<'a> {
    pub(super) picture: &'a Picture<'a>,
    /// Its bytes, where a card has shown it already, and as what.
    pub(super) shown: Option<(&'a Arc<Display>, &'a [u8])>,
}

/// How a picture is packed, by what the viewer asked for and whether the picture rests.
pub(super) fn codec(asked: Codec, converged: bool) -> PayloadCodec {
    match asked {
        Codec::Auto if converged => PayloadCodec::Png,
        Codec::Auto | Codec::Jpeg => PayloadCodec::Jpeg,
        Codec::Png => PayloadCodec::Png,
        Codec::Float => PayloadCodec::Float,
    }
}

impl Packer {
    /// How pictures are shown.
    pub(super) fn display(&mut self, quality: &Quality) -> &Arc<Display> {
        let (tone_map, exposure_ev) = (quality.tone_map, quality.exposure_ev);
        let fits = |(made, ev, _): &(_, f32, _)| *made == tone_map && *ev == exposure_ev;
        if !self.display.as_ref().is_some_and(fits) {
            self.display = None;
        }
        let make = || {
            let display = Display::new(convert::tone_map(tone_map), exposure_ev);
            (tone_map, exposure_ev, Arc::new(display))
        };
        &self.display.get_or_insert_with(make).2
    }

    /// The payload of a frame, with dots in `marked` pixels unless it is a float one. Runs its parallel parts on the current rayon pool.
    pub(super) fn pack(
        &mut self,
        Packed { picture, shown }: Packed<'_>,
        quality: &Quality,
        codec: PayloadCodec,
        marked: &[UVec2],
    ) -> Result<Vec<u8>, EncodeError> {
        if codec == PayloadCodec::Float {
            return Ok(images::rgb_f32_le(&picture.radiance()));
        }
        let display = self.display(quality);
        let mut bytes = match shown {
            Some((shown_as, bytes)) if Arc::ptr_eq(shown_as, display) => bytes.to_vec(),
            _ => display.show_all(&picture.radiance()),
        };
        marked.iter().for_each(|pixel| mark(&mut bytes, picture.size(), *pixel));
        match codec {
            PayloadCodec::Png => images::png_fast(&bytes, picture.size()),
            _ => images::jpeg(&bytes, picture.size(), JpegQuality::clamped(quality.jpeg_quality)),
        }
    }
}

/// Of dots, sRGB: a colour that surfaces seldom have.
const DOT: [u8; 3] = [255, 40, 160];
/// Width of a picture from which on dots are two pixels wide and high: single ones are lost there, in JPEG most of all.
const WIDE_DOTS_FROM: u32 = 320;

/// Marks a pixel of sRGB bytes `[h × w × 3]`; in large pictures also those right of and below it.
fn mark(bytes: &mut [u8], size: PictureSize, pixel: UVec2) {
    let width = if size.width() < WIDE_DOTS_FROM { 1 } else { 2 };
    let end = (pixel + width).min(UVec2::new(size.width(), size.height()));
    for y in pixel.y..end.y {
        let row = y as usize * size.width() as usize;
        let (first, last) = (3 * (row + pixel.x as usize), 3 * (row + end.x as usize));
        bytes[first..last].as_chunks_mut().0.fill(DOT);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Dots colour their pixels and no others, also at borders.
    #[test]
    fn dots_stay_in_the_picture() {
        for (width, coloured) in [(4, [1, 1]), (400, [4, 1])] {
            let size = PictureSize::new(width, 3).unwrap();
            for (pixel, coloured) in [UVec2::ZERO, UVec2::new(width - 1, 2)].into_iter().zip(coloured) {
                let mut bytes = vec![0; size.pixel_count() * 3];
                mark(&mut bytes, size, pixel);
                assert_eq!(bytes.chunks(3).filter(|rgb| *rgb == DOT).count(), coloured);
                assert_eq!(bytes.iter().filter(|byte| **byte > 0).count(), 3 * coloured);
            }
        }
    }
}
