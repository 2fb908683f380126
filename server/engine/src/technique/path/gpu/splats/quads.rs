//! Records drawn as quads over the pixels in which the spheres of their reach show, whose sums the card blends: the way of
//! [Gautron2008, 8.3]. A step then answers by the sums.

use std::{ops::Range, sync::Arc, time::Instant};

use lumicast_shaders::{IRRADIANCE_RESOLVE, IRRADIANCE_SPLAT};

use super::{GpuWorld, Pace, Pixels, RecordsOnCard};
use crate::gpu::{
    BindGroup, Binding, GpuError, Layout, Overlap, Pipeline, Quads, RasterPipeline, Session, SumsBegin,
    Target,
};

/// What draws records, and answers.
#[derive(Debug)]
pub(super) struct QuadSteps {
    splat: RasterPipeline,
    splat_layout: Arc<Layout>,
    resolve: Arc<Pipeline>,
    resolve_layout: Arc<Layout>,
}

impl QuadSteps {
    /// Errors: [`GpuError::Insufficient`] where the card cannot add up floats.
    pub(super) fn new(session: &Session, world: &GpuWorld) -> Result<QuadSteps, GpuError> {
        let [uniform, read, write] = [Binding::Uniform, Binding::Read, Binding::Write];
        let splat_layout = session.raster_layout(&[uniform, read, read, read, read])?;
        let splat = session.raster_pipeline(&IRRADIANCE_SPLAT, &world.constants, &[&*splat_layout])?;
        let resolve_layout = session.layout(&[uniform, read, read, write, write])?;
        let resolve = session.pipeline(&IRRADIANCE_RESOLVE, &world.constants, &[&*resolve_layout])?;
        Ok(QuadSteps { splat, splat_layout, resolve, resolve_layout })
    }
}

/// Records of caches, and how many are drawn at once.
pub(super) struct Drawing<'a> {
    steps: &'a QuadSteps,
    pixels: &'a Pixels,
    target: Target,
    splat_group: BindGroup,
    resolve_group: BindGroup,
    at_once: u32,
    pace: Pace,
}

impl<'a> Drawing<'a> {
    pub(super) fn new(
        session: &Session,
        steps: &'a QuadSteps,
        pixels: &'a Pixels,
        RecordsOnCard { buffers: [records, words], .. }: &RecordsOnCard,
        pace: Pace,
    ) -> Result<Drawing<'a>, GpuError> {
        let Pixels { picture, header, drawn, points, answers, missing } = pixels;
        let size = [picture.row, picture.height];
        let splat = [header, points, answers, records, words];
        let at_once = u32::try_from(pace.covered_first / pixels.count()).unwrap_or(u32::MAX);
        Ok(Drawing {
            steps,
            pixels,
            target: session.target("sums of records", size, Overlap::Sum)?,
            splat_group: session.bind(&steps.splat_layout, &splat)?,
            resolve_group: session.bind(&steps.resolve_layout, &[header, points, drawn, answers, missing])?,
            at_once: at_once.clamp(1, pace.at_once_max),
            pace,
        })
    }

    /// Draws the records of a cache, as many at once as take no longer than they may, and answers by their sums.
    ///
    /// - `records`: of all
    ///
    /// Returns the seconds that it took on the device's clock, where that is asked.
    pub(super) fn add_cache(
        &mut self,
        session: &Arc<Session>,
        records: Range<u32>,
    ) -> Result<Option<f64>, GpuError> {
        let Pixels { picture, drawn, .. } = self.pixels;
        let mut gpu_seconds = Some(0.0);
        let QuadSteps { splat, resolve, .. } = self.steps;
        let mut next = records.start;
        loop {
            let start = Instant::now();
            let numbers = next..records.end.min(next.saturating_add(self.at_once));
            let begins = if next == records.start { SumsBegin::AtZero } else { SumsBegin::AsTheyAre };
            next = numbers.end;
            let mut batch = (self.pace.begin)(session, "records of a picture")?;
            let quads = Quads { size: [picture.width, picture.height], numbers, begins };
            batch.add(splat, &[&self.splat_group], &self.target, quads)?;
            if next == records.end {
                batch.copy_target(&self.target, drawn, 0)?;
                let workgroups = resolve.workgroups(self.pixels.count() as u64);
                batch.dispatch(resolve, &[&self.resolve_group], workgroups)?;
            }
            let of_batch = batch.submit()?.gpu_seconds()?;
            gpu_seconds = gpu_seconds.zip(of_batch).map(|(before, of_batch)| before + of_batch);
            if next == records.end {
                return Ok(gpu_seconds);
            }
            let seconds = start.elapsed().as_secs_f64();
            if seconds > self.pace.seconds_max {
                self.at_once = (self.at_once / 2).max(1);
            } else if seconds < self.pace.seconds_max / 3.0 {
                self.at_once = self.at_once.saturating_mul(2).min(self.pace.at_once_max);
            }
        }
    }
}
