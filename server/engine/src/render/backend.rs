//! Where a picture is drawn: on the CPU, or on a graphics card.
//!
//! Light is learnt and errors are measured on the CPU in either case; what a card draws are samples of the picture, the same
//! that the CPU would have drawn but for rounding. So a picture may be begun on one and ended on the other, and where a card
//! fails, the CPU goes on.

use std::{
    sync::{Arc, atomic::AtomicBool},
    time::Instant,
};

use super::{Indirect, RenderSettings, Rendering, all_paths};
use crate::{
    film::{Film, PictureSize},
    gpu::{AdapterKind, Gpu, GpuError},
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
    /// On the card.
    pub gpu_seconds: f64,
    /// Of compiling shaders, beside those.
    pub shader_seconds: f64,
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
            None => Ok(BackendTrial { cpu_seconds, gpu_seconds, shader_seconds: scene.shader_seconds() }),
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
    (0..TRIAL_PASSES)
        .map(|_| {
            let start = Instant::now();
            let (canvas, products) = (Some(Canvas { view, film: &mut film }), &mut Products::default());
            technique.step(&mut Step { world, products, canvas, cancel: &cancel });
            start.elapsed().as_secs_f64()
        })
        .fold(f64::INFINITY, f64::min)
}

/// The card is a processor that runs on the CPU's own cores: choosing it gains nothing.
pub fn is_software(gpu: &Gpu) -> bool {
    gpu.report().kind == AdapterKind::Software
}

impl RenderSettings {
    /// Whether a card can draw such pictures.
    ///
    /// Errors: [`CpuOnly`] for those that look up records of irradiance.
    pub fn draws_on_gpu(&self) -> Result<(), CpuOnly> {
        match self.indirect {
            Indirect::Path | Indirect::Octree | Indirect::None => Ok(()),
            Indirect::Auto => Err(CpuOnly { technique: "auto", what: "irradiance cache" }),
            Indirect::Irradiance => Err(CpuOnly { technique: "irradiance", what: "irradiance cache" }),
        }
    }
}

impl Rendering {
    /// Draws on a card from now on. Caustics are then those that the octree knows, where light is looked up there: their own
    /// photons are seen on the CPU only.
    ///
    /// Errors: as [`RenderSettings::draws_on_gpu`].
    /// - `scene`: of the same world
    pub fn draw_on(&mut self, scene: Arc<GpuScene>) -> Result<(), CpuOnly> {
        self.settings.draws_on_gpu()?;
        self.look_caustics_up();
        self.hidden = [None, None];
        self.gpu = Some(Box::new(GpuPathTracer::new(scene, all_paths(&self.settings))));
        self.gpu_failure = None;
        Ok(())
    }

    /// It is drawn on a card.
    pub fn is_on_gpu(&self) -> bool {
        self.gpu.is_some()
    }

    /// Why it is drawn on a card no longer.
    pub fn gpu_failure(&self) -> Option<&GpuError> {
        self.gpu_failure.as_ref()
    }

    /// The scene on the card that it is drawn on.
    pub fn gpu_scene(&self) -> Option<&Arc<GpuScene>> {
        self.gpu.as_ref().map(|gpu| gpu.scene())
    }

    /// A pass on the card; `None` where it is drawn on the CPU, now or again.
    pub(super) fn draw_on_gpu(&mut self, cancel: &AtomicBool) -> Option<Progress> {
        let gpu = self.gpu.as_mut()?;
        gpu.draw_as(&self.technique);
        let canvas = Some(Canvas { view: &self.view, film: &mut self.film });
        let products = &mut Products::default();
        let progress = gpu.step(&mut Step { world: &self.world, products, canvas, cancel });
        if let Some(error) = gpu.failure() {
            self.gpu_failure = Some(error.clone());
            self.gpu = None;
        }
        Some(progress)
    }
}
