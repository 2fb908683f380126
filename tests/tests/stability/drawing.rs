//! Small pictures by every technique, with a bound on how long they may take.

use std::num::{NonZeroU32, NonZeroUsize};
use std::sync::{Arc, OnceLock, atomic::AtomicBool};
use std::time::{Duration, Instant};

use lumicast_engine::film::PictureSize;
use lumicast_engine::gpu::{AdapterChoice, Gpu};
use lumicast_engine::render::{Backend, IlluminationSettings, Indirect, Learning, RenderSettings, Rendering};
use lumicast_engine::technique::irradiance::Visits;
use lumicast_engine::technique::path::GpuScene;
use lumicast_engine::transport::World;

/// A technique on a backend.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Technique {
    pub(crate) indirect: Indirect,
    pub(crate) backend: Backend,
}

/// Those of the CPU first.
pub(crate) const TECHNIQUES: [Technique; 7] = [
    Technique::on_cpu(Indirect::Path),
    Technique::on_cpu(Indirect::Octree),
    Technique::on_cpu(Indirect::Irradiance),
    Technique::on_cpu(Indirect::Auto),
    Technique { indirect: Indirect::Path, backend: Backend::Gpu },
    Technique { indirect: Indirect::Octree, backend: Backend::Gpu },
    Technique { indirect: Indirect::Irradiance, backend: Backend::Gpu },
];

impl Technique {
    pub(crate) const fn on_cpu(indirect: Indirect) -> Technique {
        Technique { indirect, backend: Backend::Cpu }
    }

    /// A picture that a card is named for, and did not help to draw, would only say again what the CPU's says.
    pub(crate) fn assert_drawn_as_named(self, rendering: &Rendering) {
        assert_eq!(
            rendering.gpu_passes() > 0,
            self.backend == Backend::Gpu,
            "{}: on a card or not",
            name(self)
        );
    }
}

/// Those that can be had: without a graphics adapter, which `LUMICAST_GPU=required` does not forgive, the ones of the CPU.
pub(crate) fn techniques() -> impl Iterator<Item = Technique> {
    TECHNIQUES.into_iter().filter(|technique| technique.backend == Backend::Cpu || gpu().is_some())
}

/// `LUMICAST_LAWS=short`: cards draw the first scene of each law alone, by one technique, since lavapipe draws several times as long as the
/// CPU does; `auto` draws no other scene either, which the techniques that it is made of do; whether laws can fail is tried on the CPU.
pub(crate) fn are_short() -> bool {
    let asked = std::env::var("LUMICAST_LAWS").ok();
    assert!(
        asked.as_deref().is_none_or(|asked| asked == "short"),
        "LUMICAST_LAWS is short, or not set: {asked:?}"
    );
    asked.is_some()
}

/// The techniques by which it is tried whether a law, or a check, can fail: cards are held to the same ones.
pub(crate) fn tried() -> impl Iterator<Item = Technique> {
    techniques().filter(|technique| !are_short() || technique.backend == Backend::Cpu)
}

/// The adapter, opened once.
fn gpu() -> Option<&'static Arc<Gpu>> {
    static GPU: OnceLock<Option<Arc<Gpu>>> = OnceLock::new();
    GPU.get_or_init(|| match Gpu::open(AdapterChoice::Any) {
        Ok(gpu) => Some(Arc::new(gpu)),
        Err(error) => {
            let is_required = std::env::var("LUMICAST_GPU").is_ok_and(|value| value == "required");
            assert!(!is_required, "LUMICAST_GPU=required, and {error}");
            eprintln!("SKIPPED on graphics cards: {error}");
            None
        }
    })
    .as_ref()
}

/// Steps after which a picture counts as one without end: the longest take some thousand.
const STEPS_MAX: u32 = 100_000;

/// How much work goes into a picture.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Effort {
    pub(crate) side: u32,
    pub(crate) passes: u32,
    /// Photons sent out.
    pub(crate) photons: u32,
    /// Photons that a gather of the octree needs.
    pub(crate) neighbours: usize,
    /// Rays of a record of irradiance.
    pub(crate) rays: usize,
    pub(crate) patience: Duration,
}

/// What is drawn, but for the scene.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Drawn {
    pub(crate) technique: Technique,
    pub(crate) seed: u64,
    pub(crate) bounces_max: Option<u32>,
}

/// A picture by the scene's first camera.
///
/// # Errors
/// When it comes to no end, in words.
pub(crate) fn draw(world: &Arc<World>, of: Drawn, effort: &Effort) -> Result<Rendering, String> {
    let Drawn { technique: Technique { indirect, backend }, seed, bounces_max } = of;
    let learning = match indirect {
        // The chain is one only if it draws while it learns.
        Indirect::Auto => Learning::InStep,
        _ => Learning::First,
    };
    let settings =
        RenderSettings { indirect, backend, seed, bounces_max, learning, ..RenderSettings::default() };
    let mut light = IlluminationSettings::of(&settings);
    light.photons.emitted_count = effort.photons;
    light.octree.photon_count = effort.photons;
    light.octree.neighbours_min = NonZeroUsize::new(effort.neighbours).unwrap_or(NonZeroUsize::MIN);
    light.irradiance.ray_count = NonZeroUsize::new(effort.rays).unwrap_or(NonZeroUsize::MIN);
    light.irradiance.visits = Visits::exactly(NonZeroU32::new(2).unwrap_or(NonZeroU32::MIN));
    let view = world.scene().camera_view(None).ok_or("the scene has no camera")?;
    let size = PictureSize::new(effort.side, effort.side).map_err(|error| error.to_string())?;
    let mut rendering = Rendering::learning_by((world.clone(), light), view, size, settings);
    if let (Backend::Gpu, Some(gpu)) = (backend, gpu()) {
        let scene = Arc::new(GpuScene::new(Arc::clone(gpu), Arc::clone(world)));
        rendering.draw_and_learn_on(scene);
    }
    let (start, never) = (Instant::now(), AtomicBool::new(false));
    let mut steps = 0;
    while rendering.passes() < effort.passes || !rendering.is_whole() || !rendering.knows_its_light() {
        rendering.step(&never);
        steps += 1;
        if let Some(error) = rendering.gpu_failure() {
            return Err(error.to_string());
        }
        if steps > STEPS_MAX || start.elapsed() > effort.patience {
            let (taken, passes) = (start.elapsed(), rendering.passes());
            return Err(format!("no end after {steps} steps, {taken:.1?} and {passes} passes"));
        }
    }
    Ok(rendering)
}

pub(crate) fn name(technique: Technique) -> &'static str {
    match (technique.indirect, technique.backend) {
        (Indirect::Auto, Backend::Cpu) => "auto",
        (Indirect::Path, Backend::Cpu) => "path",
        (Indirect::Octree, Backend::Cpu) => "octree",
        (Indirect::Irradiance, Backend::Cpu) => "irradiance",
        (Indirect::Irradiance, Backend::Gpu) => "irradiance, gpu",
        (Indirect::None, _) => "none",
        (Indirect::Auto, Backend::Gpu) => "auto, gpu",
        (Indirect::Path, Backend::Gpu) => "path, gpu",
        (Indirect::Octree, Backend::Gpu) => "octree, gpu",
    }
}
