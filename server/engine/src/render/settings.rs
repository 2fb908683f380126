//! How a picture is made: what whoever asks for it chooses, and what follows from that for a scene.

use std::time::Instant;

use super::measuring::MeasuringShare;
use crate::{
    effects::{EffectChoices, EffectKind, EffectPlan},
    film::{Denoising, Film},
    technique::{
        caustics::{CausticSettings, CausticSketch},
        irradiance::IrradianceCache,
    },
    transport::World,
};

/// What computes indirect light.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Indirect {
    /// The best chain that exists so far: the irradiance cache, answered for by the light octree where it has no records yet,
    /// and the path tracer as far as its samples make the picture better. Without a second bounce, the path tracer.
    Auto,
    /// The path tracer.
    #[default]
    Path,
    /// The light octree; light seen directly and direct light are sampled.
    Octree,
    /// The irradiance cache, gathered from direct light and photons; light seen directly and direct light are sampled.
    Irradiance,
    /// Nothing: only light seen directly and direct light are shown.
    None,
}

impl Indirect {
    /// Each of them, the best chain first.
    pub const ALL: [Indirect; 5] =
        [Indirect::Auto, Indirect::Octree, Indirect::Irradiance, Indirect::Path, Indirect::None];

    /// As it is asked for.
    pub fn name(self) -> &'static str {
        match self {
            Indirect::Auto => "auto",
            Indirect::Path => "path",
            Indirect::Octree => "octree",
            Indirect::Irradiance => "irradiance",
            Indirect::None => "none",
        }
    }
}

/// What is learnt of a scene's light.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Learnt {
    /// Photons and the octree made of them.
    Octree,
    /// Those, and records of irradiance gathered from them.
    Records,
}

/// Where the samples of a picture are drawn, and the light of records is gathered. Other light is learnt and errors are measured
/// on the CPU in either case.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Backend {
    /// On the CPU.
    #[default]
    Cpu,
    /// On a graphics card, once the picture is [given one](super::Rendering::draw_on).
    Gpu,
}

impl Backend {
    /// Memory of one pixel of a film, beside the film's own: samples on their way from a card.
    pub(super) fn bytes_per_pixel(self) -> usize {
        match self {
            #[cfg(feature = "gpu")]
            Backend::Gpu => crate::technique::path::GpuPathTracer::BYTES_PER_PIXEL,
            _ => 0,
        }
    }
}

/// When a picture that learns of its light by itself is drawn.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Learning {
    /// Once all is known: the picture depends on no clock.
    #[default]
    First,
    /// As soon as something is known, sharing the work with learning more by numbers of rays: the picture depends on no clock.
    InStep,
    /// As soon as something is known, sharing the time with learning more; from a moment on nothing more is learnt, so that
    /// what is known by then is seen by more than a sample or two.
    Alongside {
        /// That moment.
        until: Option<Instant>,
    },
}

/// How a picture is made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RenderSettings {
    /// Technique of indirect light.
    pub indirect: Indirect,
    /// Most scatterings of a path (1: emission and direct light); `None`: no bound. Where light is
    /// [learnt](RenderSettings::learns) it bounds what surfaces receive, whatever mirrors and glass lie between them and the eye.
    pub bounces_max: Option<u32>,
    /// Names the random numbers.
    pub seed: u64,
    /// When it is drawn.
    pub learning: Learning,
    /// Effects that are chosen in place of the plan.
    pub effects: EffectChoices,
    /// Time that measuring what is looked up may take, beside what [`super::Rendering::aim_at`] allows.
    pub measuring: MeasuringShare,
    /// Where it is drawn.
    pub backend: Backend,
    /// Noise stays in what is looked up: [denoised](crate::film::Picture::denoised) it is else, also while nothing is known yet to look up. What is
    /// asked to be path-traced never is.
    pub keeps_noise: bool,
}

impl RenderSettings {
    /// Memory that a picture is to be given, about: that of its films, of records laid out over it, and of maps of caustics with as many
    /// photons as they may have.
    ///
    /// - `plan`: of the scene
    pub fn picture_bytes(&self, plan: &EffectPlan, pixel_count: usize) -> usize {
        let films = if self.indirect == Indirect::Auto { 2 } else { 1 };
        // Of hidden light each film has its own, and each half of the measure.
        let denoising = if self.takes_noise_off() { Denoising::BYTES_PER_PIXEL } else { 0 };
        let beyond = if self.notes_beyond(plan) { Film::BYTES_BEYOND } else { 0 };
        let maps = usize::from(self.focuses(plan)) + 4 * usize::from(self.brings_hidden(plan));
        let of = CausticSettings::of(pixel_count, self.bounces_max, self.seed);
        let light = (maps * of.bytes_max()).max(CausticSketch::bytes_max(pixel_count));
        let laid_out = match self.learns(plan) {
            Some(Learnt::Records) => IrradianceCache::BYTES_PER_PIXEL,
            _ => 0,
        };
        films * pixel_count * (Film::BYTES_PER_PIXEL + self.backend.bytes_per_pixel())
            + pixel_count * (laid_out + denoising + beyond)
            + if maps > 0 { light } else { 0 }
    }

    /// Light that comes by way of other surfaces is looked up, with an error that is more than noise. None comes by a single scattering.
    pub(super) fn looks_up(&self) -> bool {
        match self.indirect {
            Indirect::Octree | Indirect::Irradiance | Indirect::Auto => {
                self.bounces_max.is_none_or(|bounces| bounces > 1)
            }
            Indirect::Path | Indirect::None => false,
        }
    }

    /// Light that is to be looked up is path-traced as long as nothing is known of it. Who watches, and what is to be the best there is, is not
    /// to be without it; single pictures begin with direct light, whose samples all count to the end.
    pub(super) fn traces_unknown(&self) -> bool {
        self.looks_up() && (self.indirect == Indirect::Auto || self.is_watched())
    }

    /// Somebody looks on while it is drawn.
    pub(super) fn is_watched(&self) -> bool {
        self.learning == Learning::Alongside { until: None }
    }

    /// Noise is taken off what is looked up.
    pub(super) fn takes_noise_off(&self) -> bool {
        self.looks_up() && !self.keeps_noise
    }

    /// The film of what is looked up keeps what is seen beyond mirrors and glass.
    ///
    /// - `plan`: of the scene
    pub(super) fn notes_beyond(&self, plan: &EffectPlan) -> bool {
        let shows_others = plan.is_on(EffectKind::Mirror) || plan.is_on(EffectKind::Glass);
        self.takes_noise_off() && plan.facts.diffuse > 0 && shows_others
    }

    /// Photons of its own bring caustics.
    pub(super) fn focuses(&self, plan: &EffectPlan) -> bool {
        self.looks_up() && self.effects.caustics.runs(plan.is_on(EffectKind::Caustics))
    }

    /// Photons bring what path tracing cannot find; also where caustics are turned off: what surfaces send on of them is indirect
    /// light.
    pub(super) fn brings_hidden(&self, plan: &EffectPlan) -> bool {
        self.looks_up() && plan.is_on(EffectKind::Caustics) && plan.facts.hides_light()
    }

    /// Caustics for first pictures, whatever camera they are of; `None` where pictures have none of their own. Takes some
    /// milliseconds.
    ///
    /// - `plan`: of the world's scene
    pub fn sketch(&self, world: &World, plan: &EffectPlan) -> Option<CausticSketch> {
        let of = CausticSettings::for_sketch(self.bounces_max, self.seed);
        self.focuses(plan).then(|| CausticSketch::of(world, &of))
    }

    /// What is learnt for that; nothing where no surface lights another.
    ///
    /// - `plan`: of the scene
    pub fn learns(&self, plan: &EffectPlan) -> Option<Learnt> {
        let learnt = if self.indirect == Indirect::Octree { Learnt::Octree } else { Learnt::Records };
        let runs = self.effects.indirect.runs(plan.is_on(EffectKind::Indirect));
        (self.looks_up() && runs).then_some(learnt)
    }
}
