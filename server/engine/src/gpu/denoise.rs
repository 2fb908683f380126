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
    denoise::{ALONE, MARGIN, NUMBERS, PLANES, Planes, SURFACE_MAX, SURFACE_PLANES, Unjoined},
};

/// Pixels at once, margins included: planes of their surfaces take 80 MiB, within the 128 MiB that every adapter binds.
const PIXELS_AT_ONCE: usize = 1 << 21;
/// Bytes of what a pixel's surface is told by, the largest buffer.
const SURFACE_BYTES: u64 = (SURFACE_PLANES * size_of::<f32>()) as u64;
/// Light and its variance are never so large: scaled, light is a hundred at most, and the variance of a mean no more than its square,
/// 10⁴, but half of N times as much where N passes have lost the samples of some class: 5·10⁹ after 10⁶. Differences of light by what they are multiplied by stay in the range of floats.
const LIGHT_MAX: f32 = 1e7;
const VARIANCE_MAX: f32 = 1e16;

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
        let binding_max = session.limits.max_storage_buffer_binding_size;
        Ok(DenoiseOnCard {
            session: Arc::clone(session),
            known_better: session.pipeline(&FILM_KNOWN_BETTER, &constants, &[&layout])?,
            per_difference: session.pipeline(&FILM_PER_DIFFERENCE, &constants, &[&layout])?,
            joined: session.pipeline(&FILM_JOINED, &constants, &[&layout_joined])?,
            layout,
            layout_joined,
            pixels_at_once: PIXELS_AT_ONCE.min((binding_max / SURFACE_BYTES) as usize),
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
        // Rows that a pixel depends on, on either side: one for what is known better, then at each level those that it joins.
        let reach = 1 << unjoined.levels;
        let rows_at_once = (self.pixels_at_once / stride).saturating_sub(2 * reach).max(1);
        let mut numbers = Vec::with_capacity(rows * ALONE * stride);
        let mut step_seconds = Some(0.0);
        for first in (0..rows).step_by(rows_at_once) {
            let wanted = first..rows.min(first + rows_at_once);
            let rows = wanted.start.saturating_sub(reach)..rows.min(wanted.end + reach);
            let mut band = Band::of(self, unjoined, rows, begin)?;
            let read_back = band.run(wanted)?;
            numbers.extend(bytemuck::pod_collect_to_vec::<u8, f32>(&read_back.collect()?));
            step_seconds = step_seconds.zip(band.step_seconds).map(|(all, more)| all + more);
        }
        Ok((unjoined.light.of_numbers(numbers), step_seconds))
    }
}

/// Some rows of a picture on the card.
struct Band<'a> {
    card: &'a DenoiseOnCard,
    begin: Begin,
    levels: usize,
    rows: Range<usize>,
    header: GpuBand,
    surfaces: Buffer,
    /// Before a step and after it, in turns.
    light: [Buffer; 2],
    per_difference: Buffer,
    step_seconds: Option<f64>,
}

impl<'a> Band<'a> {
    fn of(
        card: &'a DenoiseOnCard,
        unjoined: &Unjoined<'_>,
        rows: Range<usize>,
        begin: Begin,
    ) -> Result<Band<'a>, GpuError> {
        let session = &card.session;
        let stride = unjoined.light.stride();
        let light = session.buffer_of("light", unjoined.light.of_rows(rows.clone()))?;
        let joined = session.buffer_zeroed("light, joined", light.byte_count())?;
        Ok(Band {
            card,
            begin,
            levels: unjoined.levels,
            header: GpuBand {
                width: unjoined.light.width() as u32,
                rows: rows.len() as u32,
                stride: stride as u32,
                step: 1,
                is_believed: u32::from(unjoined.is_believed),
            },
            surfaces: session.buffer_of("surfaces", unjoined.surfaces.of_rows(rows.clone()))?,
            light: [light, joined],
            per_difference: session
                .buffer_zeroed("what differences count", (rows.len() * stride * size_of::<f32>()) as u64)?,
            rows,
            step_seconds: Some(0.0),
        })
    }

    /// All levels.
    ///
    /// - `wanted`: rows that are brought back, of the whole picture
    fn run(&mut self, wanted: Range<usize>) -> Result<ReadBack, GpuError> {
        let bytes_of_row = (ALONE * self.header.stride as usize * size_of::<f32>()) as u64;
        let row = |row: usize| (row - self.rows.start) as u64 * bytes_of_row;
        let bytes = row(wanted.start)..row(wanted.end);
        let mut batch = (self.begin)(&self.card.session, "variance that is known better")?;
        self.know_better(&mut batch)?;
        for level in 0..self.levels {
            self.submit(batch)?;
            batch = (self.begin)(&self.card.session, "pixels that are joined")?;
            self.join(&mut batch, 1 << level)?;
        }
        let read_back = batch.read_back(&self.light[0], bytes)?;
        self.submit(batch)?;
        Ok(read_back)
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
        let Band { card, header, surfaces, light: [before, after], .. } = self;
        let header = card.session.buffer_of("band", &[*header])?;
        let group = card.session.bind(&card.layout, &[&header, surfaces, before, after])?;
        batch.dispatch(&card.known_better, &[&group], self.workgroups(&self.card.known_better))?;
        self.light.swap(0, 1);
        Ok(())
    }

    fn join(&mut self, batch: &mut Batch, step: u32) -> Result<(), GpuError> {
        let Band { card, header, surfaces, light: [before, after], per_difference, .. } = self;
        let header = card.session.buffer_of("band", &[GpuBand { step, ..*header }])?;
        let group = card.session.bind(&card.layout, &[&header, surfaces, before, per_difference])?;
        let buffers = [&header, surfaces, before, after, per_difference];
        let group_joined = card.session.bind(&card.layout_joined, &buffers)?;
        batch.dispatch(&card.per_difference, &[&group], self.workgroups(&self.card.per_difference))?;
        batch.dispatch(&self.card.joined, &[&group_joined], self.workgroups(&self.card.joined))?;
        self.light.swap(0, 1);
        Ok(())
    }

    fn workgroups(&self, pipeline: &Pipeline) -> [u32; 3] {
        pipeline.workgroups(u64::from(self.header.width) * u64::from(self.header.rows))
    }
}
