//! Small pictures by every technique, with a bound on how long they may take.

use std::num::{NonZeroU32, NonZeroUsize};
use std::sync::{Arc, atomic::AtomicBool};
use std::time::{Duration, Instant};

use lumicast_engine::film::PictureSize;
use lumicast_engine::render::{IlluminationSettings, Indirect, Learning, RenderSettings, Rendering};
use lumicast_engine::transport::World;

pub(crate) const TECHNIQUES: [Indirect; 4] =
    [Indirect::Path, Indirect::Octree, Indirect::Irradiance, Indirect::Auto];

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
    pub(crate) indirect: Indirect,
    pub(crate) seed: u64,
    pub(crate) bounces_max: Option<u32>,
}

/// A picture by the scene's first camera.
///
/// # Errors
/// When it comes to no end, in words.
pub(crate) fn draw(world: &Arc<World>, of: Drawn, effort: &Effort) -> Result<Rendering, String> {
    let learning = match of.indirect {
        // The chain is one only if it draws while it learns.
        Indirect::Auto => Learning::InStep,
        _ => Learning::First,
    };
    let Drawn { indirect, seed, bounces_max } = of;
    let settings = RenderSettings { indirect, seed, bounces_max, learning, ..RenderSettings::default() };
    let mut light = IlluminationSettings::of(&settings);
    light.photons.emitted_count = effort.photons;
    light.octree.photon_count = effort.photons;
    light.octree.neighbours_min = NonZeroUsize::new(effort.neighbours).unwrap_or(NonZeroUsize::MIN);
    light.irradiance.ray_count = NonZeroUsize::new(effort.rays).unwrap_or(NonZeroUsize::MIN);
    light.irradiance.visits = NonZeroU32::new(2).unwrap_or(NonZeroU32::MIN);
    let view = world.scene().camera_view(None).ok_or("the scene has no camera")?;
    let size = PictureSize::new(effort.side, effort.side).map_err(|error| error.to_string())?;
    let mut rendering = Rendering::learning_by((world.clone(), light), view, size, settings);
    let (start, never) = (Instant::now(), AtomicBool::new(false));
    let mut steps = 0;
    while rendering.passes() < effort.passes || !rendering.is_whole() || !rendering.knows_its_light() {
        rendering.step(&never);
        steps += 1;
        if steps > STEPS_MAX || start.elapsed() > effort.patience {
            let (taken, passes) = (start.elapsed(), rendering.passes());
            return Err(format!("no end after {steps} steps, {taken:.1?} and {passes} passes"));
        }
    }
    Ok(rendering)
}

pub(crate) fn name(indirect: Indirect) -> &'static str {
    match indirect {
        Indirect::Auto => "auto",
        Indirect::Path => "path",
        Indirect::Octree => "octree",
        Indirect::Irradiance => "irradiance",
        Indirect::None => "none",
    }
}
