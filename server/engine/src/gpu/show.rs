//! Pictures as a screen shows them, made on a card: the twin of `PictureParts::mixed` and [`Display::show_all`].
//!
//! One step (`shaders/film/show.wgsl`) blends, exposes, maps and encodes: radiance goes there as floats, 12 bytes a pixel of each film,
//! and 3 bytes a pixel come back. The sRGB curve needs no power there: a display has the smallest value of every code, and the step
//! searches them, so that codes are the CPU's wherever rounding before does not carry a value past one of those, and one beside it there.
//!
//! Every number of the tone maps and weights is handed over from `film`, none stands in WGSL. Radiance goes as bits, since WGSL may assume
//! that no float is infinite or NaN; denormals may count as zero, which no exposure that is taken here can show.
//!
//! **Watchdogs**: rows of some million pixels at once, a few milliseconds of a card.

#[cfg(test)]
mod tests;

use std::{ops::Range, sync::Arc};

use bytemuck::{Pod, Zeroable};
use lumicast_shaders::{Constant, FILM_SHOW};

use super::{Batch, Binding, Buffer, GpuError, Layout, Pipeline, ReadBack, Session, batch::Begin};
use crate::{
    film::{Display, Fit, PictureParts, PictureSize, RADIANCE_MAX, TILE_SIDE, ToneMap, Weights},
    math::Rgb,
};

/// Pixels at once: a picture of 2048 × 2048. Two films of them take 48 MiB each, well within the 128 MiB that every adapter binds.
const PIXELS_AT_ONCE: usize = 1 << 22;
/// Exposures that are taken, up or down, in stops: as many as `render` takes. No denormal can be seen at any of them.
const STOPS_MAX: f32 = 64.0;
/// Pixels and bytes of what one invocation writes.
const GROUP_PIXELS: usize = 4;
const GROUP_BYTES: usize = 12;

/// `Showing` in WGSL.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
struct GpuShowing {
    into: [[f32; 4]; 3],
    out_of: [[f32; 4]; 3],
    curve: [[f32; 4]; 3],
    factor: f32,
    bright: f32,
    tone_map: u32,
    width: u32,
    row_first: u32,
    pixel_count: u32,
    tile_columns: u32,
    tile_rows: u32,
}

impl GpuShowing {
    /// All but the rows.
    ///
    /// - `weights`: of the path-traced film, if there is one
    fn new(display: &Display, size: PictureSize, weights: Option<&Weights>) -> GpuShowing {
        let fit = Fit::of(display.tone_map());
        let padded = |rows: [[f32; 3]; 3]| rows.map(|[r, g, b]| [r, g, b, 0.0]);
        let mut curve = [0.0; 12];
        curve[..fit.curve.len()].copy_from_slice(&fit.curve);
        let tiles = weights.map_or([0, 0], |weights| {
            [weights.columns as u32, (weights.values.len() / weights.columns) as u32]
        });
        let factor = 2.0 * display.factor();
        GpuShowing {
            into: padded(fit.into),
            out_of: padded(fit.out_of),
            curve: bytemuck::cast(curve),
            factor,
            bright: RADIANCE_MAX / factor,
            tone_map: display.tone_map() as u32,
            width: size.width(),
            row_first: 0,
            pixel_count: 0,
            tile_columns: tiles[0],
            tile_rows: tiles[1],
        }
    }
}

/// A picture as a screen shows it.
#[derive(Clone, Debug)]
pub struct ShownOnCard {
    /// `[h × w × 3]` sRGB bytes, rows top to bottom.
    pub codes: Vec<u8>,
    /// What the step took on the device's clock; `None` where that was not asked, or there is none.
    pub step_seconds: Option<f64>,
}

/// Shows pictures on a card. Kept by whoever shows; the next [`Session`] needs another.
#[derive(Debug)]
pub struct ShowOnCard {
    session: Arc<Session>,
    pipeline: Arc<Pipeline>,
    layout: Arc<Layout>,
    pixels_at_once: usize,
}

impl ShowOnCard {
    /// What the step is compiled with.
    pub(crate) fn constants() -> [(&'static str, Constant); 6] {
        [
            ("WORKGROUP", Constant::U32(FILM_SHOW.workgroup_size[0])),
            ("TILE_SIDE", Constant::U32(TILE_SIDE)),
            ("RADIANCE_MAX", Constant::F32(RADIANCE_MAX)),
            ("TONE_REINHARD", Constant::U32(ToneMap::Reinhard as u32)),
            ("TONE_ACES", Constant::U32(ToneMap::Aces as u32)),
            ("TONE_AGX", Constant::U32(ToneMap::AgX as u32)),
        ]
    }

    /// Compiles the step, which a session does once.
    ///
    /// Errors: [`GpuError::Shader`], [`GpuError::Lost`], [`GpuError::Failed`].
    pub fn new(session: &Arc<Session>) -> Result<ShowOnCard, GpuError> {
        let [uniform, read, write] = [Binding::Uniform, Binding::Read, Binding::Write];
        let layout = session.layout(&[uniform, read, read, read, read, write])?;
        let pipeline = session.pipeline(&FILM_SHOW, &ShowOnCard::constants(), &[&layout])?;
        Ok(ShowOnCard { session: Arc::clone(session), pipeline, layout, pixels_at_once: PIXELS_AT_ONCE })
    }

    /// `[h × w × 3]` sRGB bytes, rows top to bottom: [`Display::show_all`] of [`PictureParts::mixed`], but for codes that rounding decides,
    /// which may be one off. Takes up to 27 bytes a pixel on the card meanwhile.
    ///
    /// - `display`: with an exposure of at most 64 stops, up or down
    ///
    /// Errors: [`GpuError::OutOfMemory`] where the picture has no room, [`GpuError::Lost`] once the device is gone, [`GpuError::TimedOut`],
    /// [`GpuError::Failed`], also for other exposures, after which the session goes on.
    pub fn show(&self, display: &Display, parts: &PictureParts) -> Result<Vec<u8>, GpuError> {
        Ok(self.shown(display, parts, Session::batch)?.codes)
    }

    /// [`ShowOnCard::show`] with the time that the step takes on the card.
    ///
    /// Errors: as [`ShowOnCard::show`].
    pub fn show_timed(&self, display: &Display, parts: &PictureParts) -> Result<ShownOnCard, GpuError> {
        self.shown(display, parts, Session::timed_batch)
    }

    fn shown(&self, display: &Display, parts: &PictureParts, begin: Begin) -> Result<ShownOnCard, GpuError> {
        let showing =
            self.showing(display, parts.size, parts.traced.as_ref().map(|traced| &traced.weights))?;
        let (width, height) = (parts.size.width() as usize, parts.size.height() as usize);
        let rows_at_once = (self.pixels_at_once / width).max(1);
        let mut all = ShownOnCard { codes: Vec::with_capacity(3 * width * height), step_seconds: Some(0.0) };
        for row in (0..height).step_by(rows_at_once) {
            let rows = row..height.min(row + rows_at_once);
            let shown = self.rows(&showing, parts, rows, begin)?;
            all.codes.extend_from_slice(&shown.codes);
            all.step_seconds = all.step_seconds.zip(shown.step_seconds).map(|(all, more)| all + more);
        }
        Ok(all)
    }

    fn showing(
        &self,
        display: &Display,
        size: PictureSize,
        weights: Option<&Weights>,
    ) -> Result<Showing, GpuError> {
        let factors = (-STOPS_MAX).exp2()..=STOPS_MAX.exp2();
        if !factors.contains(&display.factor()) {
            let what = format!("exposures beyond {STOPS_MAX} stops are shown on the CPU");
            return Err(GpuError::Failed { what });
        }
        let of_tiles: Vec<f32> =
            weights.iter().flat_map(|weights| &weights.values).map(|weight| *weight as f32).collect();
        Ok(Showing {
            header: GpuShowing::new(display, size, weights),
            weights: self.session.buffer_of("weights of tiles", &of_tiles)?,
            thresholds: self.session.buffer_of("thresholds of codes", display.thresholds())?,
        })
    }

    fn rows(
        &self,
        showing: &Showing,
        parts: &PictureParts,
        rows: Range<usize>,
        begin: Begin,
    ) -> Result<ShownOnCard, GpuError> {
        let session = &self.session;
        let width = parts.size.width() as usize;
        let pixels = rows.start * width..rows.end * width;
        let traced: &[Rgb] = parts.traced.as_ref().map_or(&[], |traced| &traced.radiance[pixels.clone()]);
        let own = session.buffer_of("radiance", &parts.own[pixels.clone()])?;
        let traced = session.buffer_of("radiance, path-traced", traced)?;
        let mut batch = begin(session, "picture that is shown")?;
        let codes = self.record_rows(&mut batch, showing, (pixels.len(), rows.start), [&own, &traced])?;
        let submission = batch.submit()?;
        let mut codes = codes.collect()?;
        codes.truncate(3 * pixels.len());
        Ok(ShownOnCard { codes, step_seconds: submission.gpu_seconds()? })
    }

    /// Shows radiance that is on the card, three floats a pixel, in one piece. The bytes have up to three more at their end.
    ///
    /// Errors: as [`ShowOnCard::show`].
    pub(super) fn record(
        &self,
        batch: &mut Batch,
        display: &Display,
        size: PictureSize,
        radiance: &Buffer,
    ) -> Result<ReadBack, GpuError> {
        let showing = self.showing(display, size, None)?;
        let traced = self.session.buffer_of::<Rgb>("radiance, path-traced", &[])?;
        self.record_rows(batch, &showing, (size.pixel_count(), 0), [radiance, &traced])
    }

    /// - `pixels`: how many, and the row of the first
    /// - `films`: radiance of both
    fn record_rows(
        &self,
        batch: &mut Batch,
        showing: &Showing,
        (pixel_count, row_first): (usize, usize),
        [own, traced]: [&Buffer; 2],
    ) -> Result<ReadBack, GpuError> {
        let session = &self.session;
        let Showing { header, weights, thresholds } = showing;
        let header = GpuShowing { row_first: row_first as u32, pixel_count: pixel_count as u32, ..*header };
        let header = session.buffer_of("what is shown", &[header])?;
        let group_count = pixel_count.div_ceil(GROUP_PIXELS);
        let words = session.buffer_zeroed("codes", (group_count * GROUP_BYTES) as u64)?;
        let group = session.bind(&self.layout, &[&header, own, traced, weights, thresholds, &words])?;
        batch.dispatch(&self.pipeline, &[&group], self.pipeline.workgroups(group_count as u64))?;
        batch.read_back(&words, 0..words.byte_count())
    }
}

/// What all rows of a picture share.
struct Showing {
    header: GpuShowing,
    weights: Buffer,
    thresholds: Buffer,
}
