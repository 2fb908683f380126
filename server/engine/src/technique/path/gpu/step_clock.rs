//! How long each step of a pass takes, on the device's clock: what limits a card.
//!
//! Every dispatch is a batch of its own, since batches are what the clock measures. That costs a submission each, which is
//! not counted, and keeps the device from overlapping steps: the sum is more than a pass takes, the shares are what it is for.

use std::ops::AddAssign;

use super::{
    Film, GpuCounters, GpuPassHeader, GpuPathTracer, View,
    scene::{Ready, SHADOW_SIZES_AT, WORKGROUP},
};
use crate::{
    film::PictureSize,
    gpu::{Batch, BindGroup, GpuError},
};

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
    /// Errors: what the card does not do.
    pub fn step_seconds(&self, view: &View, size: PictureSize) -> Result<Option<StepSeconds>, GpuError> {
        let header = self.header_of(view, &Film::new(size), 0);
        let pixel_count = size.pixel_count() as u32;
        self.scene.with_ready(size.pixel_count(), self.secondary.as_ref(), |ready| {
            let capacity = ready.places.capacity;
            let mut seconds = StepSeconds::default();
            for first_pixel in (0..pixel_count).step_by(capacity as usize) {
                let path_count = capacity.min(pixel_count - first_pixel);
                let slice = GpuPassHeader { first_pixel, path_count, capacity, ..header };
                let Some(of_slice) = ready.time_slice(&slice)? else { return Ok(None) };
                seconds += of_slice;
            }
            Ok(Some(seconds))
        })
    }
}

impl Ready {
    /// A slice until its last path has ended, as [`Ready::trace`] does it.
    fn time_slice(&self, header: &GpuPassHeader) -> Result<Option<StepSeconds>, GpuError> {
        self.session.write(&self.places.header, 0, bytemuck::bytes_of(header))?;
        let groups = [&self.world.trees_group, &self.world.group, &self.places.group];
        let all = [header.path_count.div_ceil(WORKGROUP).max(1), 1, 1];
        let Some(begin) = self.time(|batch| batch.dispatch(&self.begin, &groups, all))? else {
            return Ok(None);
        };
        let mut seconds = StepSeconds { begin, ..StepSeconds::default() };
        let mut is_first = true;
        while is_first || self.rays_left()? > 0 {
            let sizes = is_first.then_some(all);
            let Some(of_scattering) = self.time_scattering(&groups, sizes)? else { return Ok(None) };
            seconds += of_scattering;
            is_first = false;
        }
        Ok(Some(seconds))
    }

    /// One scattering of all paths that go on.
    ///
    /// - `all`: workgroups of the first, whose size `turn` has not written
    fn time_scattering(
        &self,
        groups: &[&BindGroup; 3],
        all: Option<[u32; 3]>,
    ) -> Result<Option<StepSeconds>, GpuError> {
        let (shade, shade_groups) = self.shading(groups);
        let run = |batch: &mut Batch, pipeline, groups: &[&BindGroup]| match all {
            Some(all) => batch.dispatch(pipeline, groups, all),
            None => batch.dispatch_indirect(pipeline, groups, &self.sizes, 0),
        };
        let [trees, world, state] = *groups;
        let turn_groups = [trees, world, state, &self.sizes_group];
        let closest = self.time(|batch| run(batch, &self.closest, groups))?;
        let shade = self.time(|batch| run(batch, shade, &shade_groups))?;
        let turn = self.time(|batch| batch.dispatch(&self.turn, &turn_groups, [1, 1, 1]))?;
        let occluded =
            self.time(|batch| batch.dispatch_indirect(&self.occluded, groups, &self.sizes, SHADOW_SIZES_AT))?;
        let (Some(closest), Some(shade), Some(turn), Some(occluded)) = (closest, shade, turn, occluded)
        else {
            return Ok(None);
        };
        Ok(Some(StepSeconds { begin: 0.0, closest, shade, turn, occluded }))
    }

    fn time(&self, record: impl FnOnce(&mut Batch) -> Result<(), GpuError>) -> Result<Option<f64>, GpuError> {
        let mut batch = self.session.timed_batch("timed step")?;
        record(&mut batch)?;
        batch.submit()?.gpu_seconds()
    }

    fn rays_left(&self) -> Result<u32, GpuError> {
        let mut batch = self.session.batch("rays left")?;
        let read = batch.read_back(&self.places.counters, 0..size_of::<GpuCounters>() as u64)?;
        batch.submit()?;
        Ok(bytemuck::pod_read_unaligned::<GpuCounters>(&read.collect()?).ray_count)
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
        let Some(seconds) = tracer.step_seconds(&view, size).unwrap() else { return };
        assert!(seconds.by_name().iter().all(|(_, seconds)| *seconds > 0.0), "{seconds:?}");
    }
}
