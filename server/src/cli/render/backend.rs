//! `--backend`: what draws, and why.

use std::sync::Arc;

use lumicast_engine::{
    film::PictureSize,
    gpu::{AdapterChoice, AdapterReport, Gpu, GpuError},
    render::{self, BackendTrial, RenderSettings, Rendering},
    scene::CameraView,
    technique::path::GpuScene,
    transport::World,
};

use super::{CliError, arguments::Backend};
use crate::graphics;

/// What draws a picture.
pub(super) enum DrawnOn {
    /// The CPU.
    Cpu,
    /// A graphics card.
    Gpu(Arc<GpuScene>),
}

impl DrawnOn {
    /// As `--backend` asks for; what was chosen, and why, goes to standard error.
    pub(super) fn choose(
        backend: Backend,
        world: &Arc<World>,
        (view, size): (&CameraView, PictureSize),
        settings: &RenderSettings,
    ) -> Result<DrawnOn, CliError> {
        match backend {
            Backend::Cpu => Ok(DrawnOn::Cpu),
            Backend::Gpu => {
                // Whoever asks for it by name gets it, also where no more than a driver on the CPU is there.
                let gpu = Gpu::open(AdapterChoice::Any).map_err(|error| unusable(&error))?;
                eprintln!("drawing on {}: compiling shaders", described(&gpu.report()));
                let scene = Arc::new(GpuScene::new(Arc::new(gpu), world.clone()));
                settings.make_ready(&scene).map_err(|error| unusable(&error))?;
                Ok(DrawnOn::Gpu(scene))
            }
            Backend::Auto => Ok(DrawnOn::tried(world, (view, size), settings)),
        }
    }

    /// The faster one, found by drawing a little on each.
    fn tried(
        world: &Arc<World>,
        (view, size): (&CameraView, PictureSize),
        settings: &RenderSettings,
    ) -> DrawnOn {
        let settings = &RenderSettings { backend: render::Backend::Gpu, ..*settings };
        if !graphics::may_have_card() {
            return DrawnOn::Cpu;
        }
        let gpu = match Gpu::open(AdapterChoice::Hardware) {
            Ok(gpu) => gpu,
            // Without the advice that the error gives: nobody asked for a card by name.
            Err(GpuError::NoAdapter { reason }) => {
                eprintln!("drawing on the CPU: no graphics card can be used: {reason}");
                return DrawnOn::Cpu;
            }
            Err(error) => {
                eprintln!("drawing on the CPU: {error}");
                return DrawnOn::Cpu;
            }
        };
        let name = described(&gpu.report());
        let scene = Arc::new(GpuScene::new(Arc::new(gpu), world.clone()));
        eprintln!("trying {name}: compiling shaders");
        if let Err(error) = settings.make_ready(&scene) {
            eprintln!("drawing on the CPU, not on {name}: {error}");
            return DrawnOn::Cpu;
        }
        match BackendTrial::run(&scene, view, size, settings) {
            Ok(trial) => {
                let [cpu_ms, gpu_ms] = [trial.cpu_seconds, trial.gpu_seconds].map(|seconds| seconds * 1e3);
                let took = format!("by a trial a pass takes {gpu_ms:.1} ms there, {cpu_ms:.1} ms on the CPU");
                if trial.gpu_is_faster() {
                    eprintln!("drawing on {name}: {took}");
                    return DrawnOn::Gpu(scene);
                }
                eprintln!("drawing on the CPU, not on {name}: {took}");
            }
            Err(error) => eprintln!("drawing on the CPU, not on {name}: {error}"),
        }
        DrawnOn::Cpu
    }

    /// As settings name it.
    pub(super) fn backend(&self) -> render::Backend {
        match self {
            DrawnOn::Cpu => render::Backend::Cpu,
            DrawnOn::Gpu(_) => render::Backend::Gpu,
        }
    }

    /// Takes the picture there.
    pub(super) fn take(&self, rendering: &mut Rendering) {
        if let DrawnOn::Gpu(scene) = self {
            rendering.draw_and_learn_on(scene.clone());
        }
    }

    /// The card.
    pub(super) fn adapter(&self) -> Option<AdapterReport> {
        match self {
            DrawnOn::Cpu => None,
            DrawnOn::Gpu(scene) => Some(scene.gpu().report()),
        }
    }

    /// Seconds of compiling shaders.
    pub(super) fn shader_seconds(&self) -> f64 {
        match self {
            DrawnOn::Cpu => 0.0,
            DrawnOn::Gpu(scene) => scene.shader_seconds(),
        }
    }

    /// Bytes on the card.
    pub(super) fn bytes(&self) -> u64 {
        match self {
            DrawnOn::Cpu => 0,
            DrawnOn::Gpu(scene) => scene.bytes(),
        }
    }
}

/// A card that cannot be used.
pub(super) fn unusable(error: &GpuError) -> CliError {
    CliError::System { doing: "--backend gpu".into(), source: std::io::Error::other(error.to_string()) }
}

/// Name, kind and driver.
fn described(report: &AdapterReport) -> String {
    format!("{} ({}, {})", report.name, report.kind, report.api)
}
