//! Where a picture is drawn: on the CPU, or on a graphics card.
//!
//! Light is learnt and errors are measured on the CPU in either case; what a card draws are samples of the picture, the same
//! that the CPU would have drawn but for rounding. So a picture may be begun on one and ended on the other, and where a card
//! fails, the CPU goes on.

use std::{
    sync::{Arc, atomic::AtomicBool},
    time::Instant,
};

use super::{Backend, Indirect, RenderSettings, Rendering, all_paths, beside};
use crate::{
    film::{Film, PictureSize},
    gpu::GpuError,
    scene::CameraView,
    technique::{
        Canvas, Products, Progress, Step, Technique, View,
        path::{GpuPathTracer, GpuScene, PathTracer},
    },
    transport::World,
};

/// Longest side of the pictures by which backends are compared, px.
const TRIAL_SIDE_MAX: u32 = 256;
/// Passes of each; the fastest counts.
const TRIAL_PASSES: u32 = 2;

/// Why a picture cannot be drawn on a graphics card.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{technique} is drawn on the CPU only: its {what} cannot be looked up on a graphics card yet")]
pub struct CpuOnly {
    technique: &'static str,
    what: &'static str,
}

/// Seconds that a pass takes on either backend.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BackendTrial {
    /// On the threads of the pool that it was asked in.
    pub cpu_seconds: f64,
    /// On the card; infinite where it did not end its passes.
    pub gpu_seconds: f64,
}

impl BackendTrial {
    /// Draws a small picture on both.
    ///
    /// Errors: what the card does not do.
    pub fn run(
        scene: &Arc<GpuScene>,
        view: &CameraView,
        size: PictureSize,
        settings: &RenderSettings,
    ) -> Result<BackendTrial, GpuError> {
        let shrink = f64::from(size.width().max(size.height())) / f64::from(TRIAL_SIDE_MAX);
        let side = |length: u32| ((f64::from(length) / shrink.max(1.0)) as u32).max(1);
        let size = PictureSize::new(side(size.width()), side(size.height())).unwrap_or(size);
        let world = scene.world();
        let view = View::new(world, view, size);
        let mut cpu = PathTracer::new(all_paths(settings));
        let mut card = GpuPathTracer::new(Arc::clone(scene), all_paths(settings));
        let cpu_seconds = fastest_pass(&mut cpu, world, &view, size);
        let gpu_seconds = fastest_pass(&mut card, world, &view, size);
        match card.failure() {
            Some(error) => Err(error.clone()),
            None => Ok(BackendTrial { cpu_seconds, gpu_seconds }),
        }
    }

    /// The card is.
    pub fn gpu_is_faster(&self) -> bool {
        self.gpu_seconds < self.cpu_seconds
    }
}

fn fastest_pass(technique: &mut dyn Technique, world: &World, view: &View, size: PictureSize) -> f64 {
    let mut film = Film::new(size);
    let cancel = AtomicBool::new(false);
    let fastest = (0..TRIAL_PASSES)
        .map(|_| {
            let start = Instant::now();
            let (canvas, products) = (Some(Canvas { view, film: &mut film }), &mut Products::default());
            technique.step(&mut Step { world, products, canvas, cancel: &cancel });
            start.elapsed().as_secs_f64()
        })
        .fold(f64::INFINITY, f64::min);
    // A pass that a lost device cut short is no fast one.
    if film.passes_min() == TRIAL_PASSES { fastest } else { f64::INFINITY }
}

/// Rays a second of the CPU, before it has traced any.
const CPU_RAYS_PER_SECOND: f64 = 2e6;
/// Seconds of work on the CPU from which on its own rate counts.
const RATE_KNOWN_SECONDS: f64 = 0.05;

/// A picture on a card.
#[derive(Debug)]
pub(super) struct OnGpu {
    scene: Arc<GpuScene>,
    drawing: GpuPathTracer,
    /// For the path-traced film beside it.
    tracing: Option<GpuPathTracer>,
    /// What the CPU traced beside, and the seconds that took.
    cpu_rays: u64,
    cpu_seconds: f64,
}

impl OnGpu {
    /// Rays that the CPU would have traced in so many seconds.
    fn rays_in(&self, seconds: f64) -> u64 {
        let is_known = self.cpu_seconds > RATE_KNOWN_SECONDS;
        let rate = if is_known { self.cpu_rays as f64 / self.cpu_seconds } else { CPU_RAYS_PER_SECOND };
        (rate * seconds) as u64
    }

    fn failure(&self) -> Option<&GpuError> {
        self.drawing.failure().or(self.tracing.as_ref().and_then(GpuPathTracer::failure))
    }
}

impl RenderSettings {
    /// Whether a card can draw such pictures.
    ///
    /// Errors: [`CpuOnly`] for those that look up records of irradiance.
    pub fn draws_on_gpu(&self) -> Result<(), CpuOnly> {
        match self.indirect {
            Indirect::Path | Indirect::Octree | Indirect::None => Ok(()),
            Indirect::Auto if self.backend == Backend::Gpu => Ok(()),
            Indirect::Auto => {
                Err(CpuOnly { technique: "auto, as it is chained on the CPU,", what: "irradiance cache" })
            }
            Indirect::Irradiance => Err(CpuOnly { technique: "irradiance", what: "irradiance cache" }),
        }
    }
}

impl Rendering {
    /// Draws on a card from now on. A film that shows caustics by photons of its own stays on the CPU, as long as nothing on the
    /// card looks at those: without them a gloss that sees a lamp in a mirror or by way of glass finds it in a few bright samples
    /// that no measure of some hundred pixels meets (rough metal in `cornell-glossy`: 41 % where 10 % were measured).
    ///
    /// - `scene`: of the same world
    ///
    /// Errors: as [`RenderSettings::draws_on_gpu`].
    pub fn draw_on(&mut self, scene: Arc<GpuScene>) -> Result<(), CpuOnly> {
        self.settings.draws_on_gpu()?;
        self.gpu = Some(Box::new(OnGpu {
            drawing: GpuPathTracer::new(Arc::clone(&scene), all_paths(&self.settings)),
            scene,
            tracing: None,
            cpu_rays: 0,
            cpu_seconds: 0.0,
        }));
        self.gpu_failure = None;
        Ok(())
    }

    /// Goes on by the CPU.
    pub fn leave_gpu(&mut self) {
        self.gpu = None;
    }

    /// It is drawn on a card.
    pub fn is_on_gpu(&self) -> bool {
        self.gpu.is_some()
    }

    /// Why it is drawn on a card no longer.
    pub fn gpu_failure(&self) -> Option<&GpuError> {
        self.gpu_failure.as_ref()
    }

    /// The same, once.
    pub fn take_gpu_failure(&mut self) -> Option<GpuError> {
        self.gpu_failure.take()
    }

    /// Passes that a card drew.
    pub fn gpu_passes(&self) -> u64 {
        self.gpu_passes
    }

    /// The scene on the card that it is drawn on.
    pub fn gpu_scene(&self) -> Option<&Arc<GpuScene>> {
        self.gpu.as_ref().map(|gpu| &gpu.scene)
    }

    /// The CPU did this beside a card. Work that is not done in rays says nothing of their rate.
    pub(super) fn note_cpu_work(&mut self, rays: u64, start: Instant) {
        if let Some(gpu) = self.gpu.as_mut().filter(|_| rays > 0) {
            gpu.cpu_rays += rays;
            gpu.cpu_seconds += start.elapsed().as_secs_f64();
        }
    }

    /// A pass on the card; `None` where the CPU draws it: after a failure, where photons of their own bring caustics, and as long
    /// as path tracing alone draws what it cannot find without photons.
    pub(super) fn draw_on_gpu(&mut self, cancel: &AtomicBool) -> Option<Progress> {
        let gpu = self.gpu.as_mut()?;
        if self.caustics.is_some() || self.hidden[0].is_some() && !self.technique.asks() {
            return None;
        }
        gpu.drawing.draw_as(&self.technique);
        let (start, shaders) = (Instant::now(), gpu.scene.shader_seconds());
        let progress = step_on_gpu(&mut gpu.drawing, (&self.world, &self.view), &mut self.film, cancel);
        let seconds = start.elapsed().as_secs_f64() - (gpu.scene.shader_seconds() - shaders);
        let rays = self.count_gpu_work(&progress, seconds);
        self.looked_up_rays += rays;
        Some(progress)
    }

    /// A pass of the path-traced film on the card; `None` where the CPU draws it.
    pub(super) fn trace_on_gpu(&mut self, cancel: &AtomicBool) -> Option<Progress> {
        if self.hidden[1].is_some() {
            return None;
        }
        let gpu = self.gpu.as_mut()?;
        let (size, settings) = (self.film.size(), beside(&self.settings));
        let film = self.traced.get_or_insert_with(|| Film::new(size));
        let scene = &gpu.scene;
        let tracing = gpu.tracing.get_or_insert_with(|| GpuPathTracer::new(Arc::clone(scene), settings));
        let (start, shaders) = (Instant::now(), gpu.scene.shader_seconds());
        let progress = step_on_gpu(tracing, (&self.world, &self.view), film, cancel);
        let seconds = start.elapsed().as_secs_f64() - (gpu.scene.shader_seconds() - shaders);
        let rays = self.count_gpu_work(&progress, seconds);
        self.traced_rays += rays;
        Some(progress)
    }

    /// What a pass on the card counts for, in rays of the CPU; takes note of failures.
    fn count_gpu_work(&mut self, progress: &Progress, seconds: f64) -> u64 {
        let Some(gpu) = &self.gpu else { return 0 };
        let rays = gpu.rays_in(seconds);
        self.surplus_rays += rays as i64 - progress.counts.all_rays() as i64;
        self.gpu_passes += u64::from(progress.complete);
        if let Some(error) = gpu.failure() {
            self.gpu_failure = Some(error.clone());
            self.gpu = None;
        }
        rays
    }
}

fn step_on_gpu(
    technique: &mut GpuPathTracer,
    (world, view): (&World, &View),
    film: &mut Film,
    cancel: &AtomicBool,
) -> Progress {
    let (canvas, products) = (Some(Canvas { view, film }), &mut Products::default());
    technique.step(&mut Step { world, products, canvas, cancel })
}
