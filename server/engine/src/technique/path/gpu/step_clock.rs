//! How long each step of a pass takes, on the device's clock: what limits a card.
//!
//! Scatterings go in batches, as they do else: cards that wait for each step by itself slow their clock down meanwhile. The clock is read
//! between steps, which keeps the device from overlapping them: the sum may be more than a pass takes, the shares are what it is for.

use std::ops::AddAssign;

use super::{
    Film, GpuPassHeader, GpuPathTracer, View,
    known::{LightBeside, undimmed},
    shadow_maps::Shadows,
    tracing::{PathStart, Tracing, workgroups_of},
};
use crate::{film::PictureSize, gpu::GpuError};

/// Seconds on the device, by step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StepSeconds {
    /// Rays through pixels.
    pub begin: f64,
    /// The nearest surface of every ray.
    pub closest: f64,
    /// Surfaces, lights and directions to go on in.
    pub shade: f64,
    /// Sizes of the steps to come.
    pub turn: f64,
    /// Whether lights are hidden.
    pub occluded: f64,
}

impl StepSeconds {
    /// With names, in the order they run in.
    pub fn by_name(&self) -> [(&'static str, f64); 5] {
        let StepSeconds { begin, closest, shade, turn, occluded } = *self;
        [("begin", begin), ("closest", closest), ("shade", shade), ("turn", turn), ("occluded", occluded)]
    }
}

impl AddAssign for StepSeconds {
    fn add_assign(&mut self, o: StepSeconds) {
        self.begin += o.begin;
        self.closest += o.closest;
        self.shade += o.shade;
        self.turn += o.turn;
        self.occluded += o.occluded;
    }
}

impl GpuPathTracer {
    /// Traces the first pass of a picture step by step and throws it away; `None` on a device without a clock.
    ///
    /// - `shadows`: who tells them
    ///
    /// Errors: what the card does not do.
    pub fn step_seconds(
        &self,
        view: &View,
        size: PictureSize,
        shadows: Shadows,
    ) -> Result<Option<StepSeconds>, GpuError> {
        let header = self.header_of(view, &Film::new(size), 0, None);
        let pixel_count = size.pixel_count() as u32;
        let (known, _) = undimmed(self.secondary.as_ref());
        let light = LightBeside { known, focused: None, shadows };
        self.scene.trace_with(PathStart::Pixels, size.pixel_count(), light, |tracing| {
            let capacity = tracing.capacity();
            let mut seconds = StepSeconds::default();
            for first_pixel in (0..pixel_count).step_by(capacity as usize) {
                let path_count = capacity.min(pixel_count - first_pixel);
                let slice = GpuPassHeader { first_pixel, path_count, capacity, ..header };
                let Some(of_slice) = tracing.time_slice(&slice)? else { return Ok(None) };
                seconds += of_slice;
            }
            Ok(Some(seconds))
        })
    }
}

/// Scatterings of the first batch and of the largest: later ones have ever fewer paths.
const SCATTERINGS_FIRST: u32 = 2;
const SCATTERINGS_MAX: u32 = 16;
/// Steps of one: `closest`, `shade`, `turn`, `occluded`.
const STEPS: u32 = 4;

impl Tracing<'_> {
    /// A slice until its last path has ended, as [`Tracing::trace_all`] does it.
    fn time_slice(self, header: &GpuPassHeader) -> Result<Option<StepSeconds>, GpuError> {
        self.write_header(header)?;
        let mut seconds = StepSeconds::default();
        let (mut first, mut scatterings) = (Some(workgroups_of(header)), SCATTERINGS_FIRST);
        while first.is_some() || self.rays_left()? > 0 {
            let Some(of_batch) = self.time_scatterings(first.take(), scatterings)? else { return Ok(None) };
            seconds += of_batch;
            scatterings = (2 * scatterings).min(SCATTERINGS_MAX);
        }
        Ok(Some(seconds))
    }

    /// Some scatterings of all paths that go on.
    ///
    /// - `first`: workgroups of the first, whose size `turn` has not written; it has to begin
    fn time_scatterings(
        self,
        mut first: Option<[u32; 3]>,
        scatterings: u32,
    ) -> Result<Option<StepSeconds>, GpuError> {
        let begins = u32::from(first.is_some());
        let mut batch = self.session.batch_of_steps("timed steps", begins + scatterings * STEPS)?;
        if let Some(all) = first {
            self.begin(&mut batch, all)?;
            batch.end_step();
        }
        for _ in 0..scatterings {
            let first = first.take();
            self.closest(&mut batch, first)?;
            batch.end_step();
            self.shade(&mut batch, first)?;
            batch.end_step();
            self.turn(&mut batch)?;
            batch.end_step();
            self.occluded(&mut batch)?;
            batch.end_step();
        }
        let Some(steps) = batch.submit()?.step_seconds()? else { return Ok(None) };
        let (begin, scatterings) = steps.split_at(begins as usize);
        let mut seconds = StepSeconds { begin: begin.iter().sum(), ..StepSeconds::default() };
        for steps in scatterings.chunks_exact(STEPS as usize) {
            seconds += StepSeconds {
                begin: 0.0,
                closest: steps[0],
                shade: steps[1],
                turn: steps[2],
                occluded: steps[3],
            };
        }
        Ok(Some(seconds))
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::{
        gpu::tests::open,
        scene::samples,
        technique::path::{GpuScene, PathSettings},
        transport::World,
    };

    /// Every step of a pass takes time, where the device has a clock.
    #[test]
    fn every_step_of_a_pass_is_timed() {
        let Some(gpu) = open() else { return };
        let scene = samples::cornell_box().unwrap();
        let camera = scene.camera_view(None).unwrap();
        let world = Arc::new(World::prepare(Arc::new(scene)));
        let size = PictureSize::new(32, 32).unwrap();
        let view = View::new(&world, &camera, size);
        let scene = Arc::new(GpuScene::new(Arc::new(gpu), world));
        let tracer = GpuPathTracer::new(scene, PathSettings::all(None, 0));
        let Some(seconds) = tracer.step_seconds(&view, size, Shadows::ByRays).unwrap() else { return };
        assert!(seconds.by_name().iter().all(|(_, seconds)| *seconds > 0.0), "{seconds:?}");
    }
}
