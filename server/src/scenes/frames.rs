//! Films → packed pictures: JPEG, PNG or float, through exposure and tone map.

use crate::convert;
use crate::images::{self, EncodeError, JpegQuality};
use lumicast_engine::film::{Display, Picture};
use lumicast_protocol::{Codec, PayloadCodec, Quality};

/// Packs the pictures of one viewer. Keeps the tables of its last exposure and tone map: making them takes longer than
/// showing a small picture.
#[derive(Debug, Default)]
pub(super) struct Packer {
    display: Option<(lumicast_protocol::ToneMap, f32, Display)>,
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
    /// The payload of a frame. Runs its parallel parts on the current rayon pool.
    pub(super) fn pack(
        &mut self,
        picture: &Picture<'_>,
        quality: &Quality,
        codec: PayloadCodec,
    ) -> Result<Vec<u8>, EncodeError> {
        let radiance = picture.radiance();
        if codec == PayloadCodec::Float {
            return Ok(images::rgb_f32_le(&radiance));
        }
        let (tone_map, exposure_ev) = (quality.tone_map, quality.exposure_ev);
        let fits = |(made, ev, _): &(_, f32, _)| *made == tone_map && *ev == exposure_ev;
        if !self.display.as_ref().is_some_and(fits) {
            let display = Display::new(convert::tone_map(tone_map), exposure_ev);
            self.display = Some((tone_map, exposure_ev, display));
        }
        // Just put there.
        let Some((_, _, display)) = &self.display else { unreachable!() };
        let bytes = display.show_all(&radiance);
        match codec {
            PayloadCodec::Png => images::png_fast(&bytes, picture.size()),
            _ => images::jpeg(&bytes, picture.size(), JpegQuality::clamped(quality.jpeg_quality)),
        }
    }
}
