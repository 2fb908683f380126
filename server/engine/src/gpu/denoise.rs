//! Noise taken off films of looked-up light on a card: the twin of `film/denoise`.
//!
//! What a film shows becomes numbers on the CPU as always: ten of each pixel's surface, three of its light, its variance. They go to the card as
//! they lie, and light and variance come back: 56 bytes a pixel there and 16 back. In between the steps of `shaders/film` are those of the CPU's
//! kernel (`known_better`, then `per_difference` and `joined` at each level), in the same order, with its numbers, none of which stands in
//! WGSL. Where cards round otherwise (quotients, roots, products that are added at once) pictures differ in the last places.
//!
//! Numbers go as bits, since WGSL may assume that no float is infinite or NaN; what films hold is finite, and light no brighter than
//! a hundred once it is scaled. Bounds in the steps keep products of anything else in the range of floats.
//!
//! **Watchdogs**: pictures go in bands of rows, two million pixels at most with the rows beyond that theirs depend on, each level by itself: some
//! milliseconds of a card. A band's pixels are the whole picture's, to the last bit.

#[cfg(test)]
mod tests;

use std::{ops::Range, sync::Arc};

use bytemuck::{Pod, Zeroable};
use lumicast_shaders::{Constant, FILM_JOINED, FILM_KNOWN_BETTER, FILM_PER_DIFFERENCE};

use super::{Batch, Binding, Buffer, GpuError, Layout, Pipeline, ReadBack, Session, batch::Begin};
use crate::film::{
    Denoising, Film,
    denoise::{
        ALONE, LEVELS, MARGIN, NUMBERS, PLANES, Planes, SURFACE_MAX, SURFACE_PLANES, Unjoined, stride_of,
    },
};

/// Pixels at once, margins included: planes of their surfaces take 80 MiB, within the 128 MiB that every adapter binds.
const PIXELS_AT_ONCE: usize = 1 << 21;
/// Bytes of what a pixel's surface is told by, the largest buffer.
const SURFACE_BYTES: u64 = (SURFACE_PLANES * size_of::<f32>()) as u64;
/// Light and its variance are never so large: scaled, light is a hundred at most, and the variance of a mean no more than its square,
/// 10⁴, but half of N times as much where N passes have lost the samples of some class: 5·10⁹ after 10⁶. Differences of light by what they are multiplied by stay in the range of floats.
const LIGHT_MAX: f32 = 1e7;
const VARIANCE_MAX: f32 = 1e16;

/// Pixels, with their margins, that a device takes at once.
pub(super) fn pixels_at_once(session: &Session) -> usize {
    PIXELS_AT_ONCE.min((session.limits.max_storage_buffer_binding_size / SURFACE_BYTES) as usize)
}

/// `Band` in WGSL.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
struct GpuBand {
    width: u32,
    rows: u32,
    stride: u32,
    step: u32,
    is_believed: u32,
}

/// A film without its noise.
#[derive(Clone, Debug)]
pub struct DenoisedOnCard {
    /// For [`Picture::denoised`](crate::film::Picture::denoised).
    pub denoising: Denoising,
    /// What the steps took on the device's clock; `None` where that was not asked, or there is none.
    pub step_seconds: Option<f64>,
}

/// Takes noise off films on a card. Kept by whoever shows them; the next [`Session`] needs another.
#[derive(Debug)]
pub struct DenoiseOnCard {
    session: Arc<Session>,
    known_better: Arc<Pipeline>,
    per_difference: Arc<Pipeline>,
    joined: Arc<Pipeline>,
    /// Of the first two steps.
    layout: Arc<Layout>,
    layout_joined: Arc<Layout>,
    pixels_at_once: usize,
}

impl DenoiseOnCard {
    /// What the steps are compiled with.
    pub(crate) fn constants() -> Vec<(&'static str, Constant)> {
        let numbers = NUMBERS.map(|(name, value)| (name, Constant::F32(value)));
        let planes = PLANES.map(|(name, plane)| (name, Constant::U32(plane as u32)));
        let ours = [
            ("WORKGROUP", Constant::U32(FILM_JOINED.workgroup_size[0])),
            ("LIGHT_PLANES", Constant::U32(ALONE as u32)),
            ("MARGIN", Constant::U32(MARGIN as u32)),
            ("SURFACE_MAX", Constant::F32(SURFACE_MAX)),
            ("LIGHT_MAX", Constant::F32(LIGHT_MAX)),
            ("VARIANCE_MAX", Constant::F32(VARIANCE_MAX)),
        ];
        numbers.into_iter().chain(planes).chain(ours).collect()
    }

    /// Compiles the steps, which a session does once.
    ///
    /// Errors: [`GpuError::Shader`], [`GpuError::Lost`], [`GpuError::Failed`].
    pub fn new(session: &Arc<Session>) -> Result<DenoiseOnCard, GpuError> {
        let [uniform, read, write] = [Binding::Uniform, Binding::Read, Binding::Write];
        let layout = session.layout(&[uniform, read, read, write])?;
        let layout_joined = session.layout(&[uniform, read, read, write, read])?;
        let constants = DenoiseOnCard::constants();
        Ok(DenoiseOnCard {
            session: Arc::clone(session),
            known_better: session.pipeline(&FILM_KNOWN_BETTER, &constants, &[&layout])?,
            per_difference: session.pipeline(&FILM_PER_DIFFERENCE, &constants, &[&layout])?,
            joined: session.pipeline(&FILM_JOINED, &constants, &[&layout_joined])?,
            layout,
            layout_joined,
            pixels_at_once: pixels_at_once(session),
        })
    }

    /// What taking noise off a film brings, for [`Picture::denoised`](crate::film::Picture::denoised): what the CPU finds but for
    /// rounding. Layers by class are still found on the CPU when they are asked for. Takes 76 bytes a pixel on the card meanwhile, of two
    /// million pixels at most.
    ///
    /// **Biased** as the CPU's; see `film/denoise.rs`.
    ///
    /// Errors: [`GpuError::OutOfMemory`] where the picture has no room, [`GpuError::Lost`] once the device is gone, [`GpuError::TimedOut`],
    /// [`GpuError::Failed`].
    pub fn denoise(&self, film: &Film) -> Result<Denoising, GpuError> {
        Ok(self.denoised(film, Session::batch)?.denoising)
    }

    /// [`DenoiseOnCard::denoise`] with the time that the steps take on the card.
    ///
    /// Errors: as [`DenoiseOnCard::denoise`].
    pub fn denoise_timed(&self, film: &Film) -> Result<DenoisedOnCard, GpuError> {
        self.denoised(film, Session::timed_batch)
    }

    /// Joins what a first pass has laid out: where it is then, and the seconds that took on the card, where they are asked.
    ///
    /// - `size`: width and rows
    pub(super) fn join_first<'a>(
        &'a self,
        buffers: &'a BandBuffers,
        size: [usize; 2],
        begin: Begin,
    ) -> Result<(&'a Buffer, Option<f64>), GpuError> {
        let mut band = Band::of(self, buffers, size, false, begin);
        let last = band.join_all(LEVELS)?;
        band.submit(last)?;
        Ok((band.light(), band.step_seconds))
    }

    fn denoised(&self, film: &Film, begin: Begin) -> Result<DenoisedOnCard, GpuError> {
        let mut step_seconds = None;
        let denoising = Denoising::found(film, |unjoined| {
            let (planes, seconds) = self.joined(unjoined, begin)?;
            step_seconds = seconds;
            Ok::<_, GpuError>(planes)
        })?;
        Ok(DenoisedOnCard { denoising, step_seconds })
    }

    /// [`Unjoined::joined`] of light alone, and the seconds that took on the card.
    fn joined(&self, unjoined: &Unjoined<'_>, begin: Begin) -> Result<(Planes, Option<f64>), GpuError> {
        let (rows, stride) = (unjoined.light.rows(), unjoined.light.stride());
        // Rows that a pixel depends on, on either side: one for what is known better, then at each level those that it joins, and one
        // more for the variance around those.
        let reach = (1 << unjoined.levels) + unjoined.levels;
        let rows_at_once = (self.pixels_at_once / stride).saturating_sub(2 * reach).max(1);
        let mut numbers = Vec::with_capacity(rows * ALONE * stride);
        let mut step_seconds = Some(0.0);
        for first in (0..rows).step_by(rows_at_once) {
            let wanted = first..rows.min(first + rows_at_once);
            let rows = wanted.start.saturating_sub(reach)..rows.min(wanted.end + reach);
            let buffers = BandBuffers::of(&self.session, unjoined, rows.clone())?;
            let size = [unjoined.light.width(), rows.len()];
            let mut band = Band::of(self, &buffers, size, unjoined.is_believed, begin);
            let read_back = band.run(unjoined.levels, wanted.start - rows.start..wanted.end - rows.start)?;
            numbers.extend(bytemuck::pod_collect_to_vec::<u8, f32>(&read_back.collect()?));
            step_seconds = step_seconds.zip(band.step_seconds).map(|(all, more)| all + more);
        }
        Ok((unjoined.light.of_numbers(numbers), step_seconds))
    }
}

/// What is known of the pixels of some rows.
#[derive(Debug)]
pub(super) struct BandBuffers {
    surfaces: Buffer,
    /// Before a step and after it, in turns.
    light: [Buffer; 2],
    per_difference: Buffer,
}

impl BandBuffers {
    /// Of rows of a picture.
    fn of(session: &Session, unjoined: &Unjoined<'_>, rows: Range<usize>) -> Result<BandBuffers, GpuError> {
        let light = session.buffer_of("light", unjoined.light.of_rows(rows.clone()))?;
        let joined = session.buffer_zeroed("light, joined", light.byte_count())?;
        let bytes = light.byte_count() / ALONE as u64;
        Ok(BandBuffers {
            surfaces: session.buffer_of("surfaces", unjoined.surfaces.of_rows(rows))?,
            light: [light, joined],
            per_difference: session.buffer_zeroed("what differences count", bytes)?,
        })
    }

    /// Of nothing yet, with room for so many pixels, margins included.
    pub(super) fn zeroed(session: &Session, pixel_count: usize) -> Result<BandBuffers, GpuError> {
        let planes =
            |name, count: usize| session.buffer_zeroed(name, (count * pixel_count * size_of::<f32>()) as u64);
        Ok(BandBuffers {
            surfaces: planes("surfaces", SURFACE_PLANES)?,
            light: [planes("light", ALONE)?, planes("light, joined", ALONE)?],
            per_difference: planes("what differences count", 1)?,
        })
    }

    /// What tells surfaces apart.
    pub(super) fn surfaces(&self) -> &Buffer {
        &self.surfaces
    }

    /// Light before it is joined.
    pub(super) fn light(&self) -> &Buffer {
        &self.light[0]
    }
}

/// Some rows of a picture that are joined on the card.
struct Band<'a> {
    card: &'a DenoiseOnCard,
    begin: Begin,
    header: GpuBand,
    buffers: &'a BandBuffers,
    /// Which of both has the light.
    turn: usize,
    step_seconds: Option<f64>,
}

impl<'a> Band<'a> {
    fn of(
        card: &'a DenoiseOnCard,
        buffers: &'a BandBuffers,
        [width, rows]: [usize; 2],
        is_believed: bool,
        begin: Begin,
    ) -> Band<'a> {
        let header = GpuBand {
            width: width as u32,
            rows: rows as u32,
            stride: stride_of(width) as u32,
            step: 1,
            is_believed: u32::from(is_believed),
        };
        Band { card, begin, header, buffers, turn: 0, step_seconds: Some(0.0) }
    }

    /// All levels.
    ///
    /// - `wanted`: rows that are brought back, of the band
    fn run(&mut self, levels: usize, wanted: Range<usize>) -> Result<ReadBack, GpuError> {
        let bytes_of_row = (ALONE * self.header.stride as usize * size_of::<f32>()) as u64;
        let mut batch = self.join_all(levels)?;
        let bytes = wanted.start as u64 * bytes_of_row..wanted.end as u64 * bytes_of_row;
        let read_back = batch.read_back(self.light(), bytes)?;
        self.submit(batch)?;
        Ok(read_back)
    }

    /// All levels, but for handing over the last.
    fn join_all(&mut self, levels: usize) -> Result<Batch, GpuError> {
        let mut batch = (self.begin)(&self.card.session, "variance that is known better")?;
        self.know_better(&mut batch)?;
        for level in 0..levels {
            self.submit(batch)?;
            batch = (self.begin)(&self.card.session, "pixels that are joined")?;
            self.join(&mut batch, 1 << level)?;
        }
        Ok(batch)
    }

    /// As far as it was joined.
    fn light(&self) -> &'a Buffer {
        &self.buffers.light[self.turn]
    }

    fn submit(&mut self, batch: Batch) -> Result<(), GpuError> {
        let submission = batch.submit()?;
        // Without a clock nobody waits in between.
        if let Some(seconds) = self.step_seconds {
            self.step_seconds = submission.gpu_seconds_if_timed()?.map(|more| seconds + more);
        }
        Ok(())
    }

    fn know_better(&mut self, batch: &mut Batch) -> Result<(), GpuError> {
        let Band { card, header, buffers, turn, .. } = *self;
        let header = card.session.buffer_of("band", &[header])?;
        let [before, after] = [&buffers.light[turn], &buffers.light[1 - turn]];
        let group = card.session.bind(&card.layout, &[&header, &buffers.surfaces, before, after])?;
        batch.dispatch(&card.known_better, &[&group], self.workgroups(&self.card.known_better))?;
        self.turn = 1 - self.turn;
        Ok(())
    }

    fn join(&mut self, batch: &mut Batch, step: u32) -> Result<(), GpuError> {
        let (card, turn, header) = (self.card, self.turn, self.header);
        let BandBuffers { surfaces, light, per_difference, .. } = self.buffers;
        let header = card.session.buffer_of("band", &[GpuBand { step, ..header }])?;
        let [before, after] = [&light[turn], &light[1 - turn]];
        let group = card.session.bind(&card.layout, &[&header, surfaces, before, per_difference])?;
        let buffers = [&header, surfaces, before, after, per_difference];
        let group_joined = card.session.bind(&card.layout_joined, &buffers)?;
        batch.dispatch(&card.per_difference, &[&group], self.workgroups(&self.card.per_difference))?;
        batch.dispatch(&card.joined, &[&group_joined], self.workgroups(&self.card.joined))?;
        self.turn = 1 - self.turn;
        Ok(())
    }

    fn workgroups(&self, pipeline: &Pipeline) -> [u32; 3] {
        pipeline.workgroups(u64::from(self.header.width) * u64::from(self.header.rows))
    }
}
