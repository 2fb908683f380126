//! The progressive loop: a view of a world, a film, and the techniques that fill it.
//!
//! [`Illumination`] is what a scene knows of its light whoever looks: photons and the octree made of them, brought up to
//! date after edits; [`Learner`] adds what is gathered from it for those who look. [`Rendering`] is one view that draws with
//! what is known. Imports every room to its left; the server talks to this one.

mod illumination;
mod learner;
#[cfg(test)]
mod tests;

use std::{
    sync::{Arc, atomic::AtomicBool},
    time::Instant,
};

use crate::{
    film::{Film, MeasuredError, Outdated, PictureSize},
    scene::CameraView,
    technique::{
        Bias, Canvas, Card, Counts, Products, Progress, SecondaryLight, Step, Technique, View,
        path::{PathClasses, PathSettings, PathTracer},
    },
    transport::World,
};

pub use illumination::{Illumination, IlluminationReport, IlluminationSettings, Stage};
pub use learner::{Learner, RecordReport};

/// Seconds of learning for each second of drawing while there is more to learn: at first what is not known about the light
/// shows more than the noise of what is sampled.
const LEARNING_SHARE: f64 = 5.0;

/// What computes indirect light.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Indirect {
    /// The best chain that exists so far: the path tracer.
    #[default]
    Auto,
    /// The path tracer.
    Path,
    /// The light octree; light seen directly and direct light are sampled.
    Octree,
    /// The irradiance cache, gathered from direct light and photons; light seen directly and direct light are sampled.
    Irradiance,
    /// Nothing: only light seen directly and direct light are shown.
    None,
}

impl Indirect {
    /// What is drawn is looked up in something learnt before, with an error that is more than noise.
    pub fn is_learnt(self) -> bool {
        matches!(self, Indirect::Octree | Indirect::Irradiance)
    }
}

/// When a picture that learns of its light by itself is drawn.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Learning {
    /// Once all is known: the picture depends on no clock.
    #[default]
    First,
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
    /// [learnt](Indirect::is_learnt) it bounds what surfaces receive, whatever mirrors and glass lie between them and the eye.
    pub bounces_max: Option<u32>,
    /// Names the random numbers.
    pub seed: u64,
    /// When it is drawn.
    pub learning: Learning,
}

/// A picture in the making.
pub struct Rendering {
    world: Arc<World>,
    view: View,
    film: Film,
    technique: Box<dyn Technique>,
    settings: RenderSettings,
    /// What the light is learnt with, where no one else does.
    learner: Option<Box<Learner>>,
    /// Seconds spent on learning less those spent on passes, since the first pass.
    lead_seconds: f64,
    counts: Counts,
}

impl std::fmt::Debug for Rendering {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Rendering")
            .field("technique", &self.card().name)
            .field("counts", &self.counts)
            .finish()
    }
}

impl Rendering {
    /// An empty film of `view`, drawn by itself: what the technique needs to know of the scene's light is learnt on the way.
    pub fn new(
        world: Arc<World>,
        view: CameraView,
        size: PictureSize,
        settings: RenderSettings,
    ) -> Rendering {
        let mut learner = Learner::new(&settings, IlluminationSettings::of(&settings)).map(Box::new);
        if let Some(learner) = &mut learner {
            learner.look(0, &view, size);
        }
        Rendering { learner, ..Rendering::with(world, view, size, settings, None) }
    }

    /// An empty film of `view` that is drawn with what is known of the scene's light; with techniques that
    /// [learn](Indirect::is_learnt) light that comes by way of other surfaces is missing where nothing is known.
    pub fn with(
        world: Arc<World>,
        view: CameraView,
        size: PictureSize,
        settings: RenderSettings,
        known: Option<Arc<dyn SecondaryLight>>,
    ) -> Rendering {
        Rendering {
            view: View::new(&world, &view, size),
            world,
            film: Film::new(size),
            technique: Box::new(tracer(&settings, known)),
            settings,
            learner: None,
            lead_seconds: 0.0,
            counts: Counts::default(),
        }
    }

    /// One step of the technique on the rayon pool it is called in; ends early, between tiles, once `cancel` is true.
    /// The film is valid after every step, cancelled or not.
    pub fn step(&mut self, cancel: &AtomicBool) -> Progress {
        if let Some(progress) = self.learn(cancel) {
            return progress;
        }
        let start = Instant::now();
        let canvas = Some(Canvas { view: &self.view, film: &mut self.film });
        // What it draws with was handed to the technique; it makes nothing for others.
        let mut step = Step { world: &self.world, products: &mut Products::default(), canvas, cancel };
        let progress = self.technique.step(&mut step);
        self.counts += progress.counts;
        self.lead_seconds -= LEARNING_SHARE * start.elapsed().as_secs_f64();
        progress
    }

    /// Learns of the scene's light; `None` when a pass is due. The first pass is drawn with the first rough answer; then
    /// learning gets [`LEARNING_SHARE`] of the time of drawing, until all is known. What is sampled of direct light is kept
    /// throughout.
    fn learn(&mut self, cancel: &AtomicBool) -> Option<Progress> {
        let is_late = self.is_late();
        let learner = self.learner.as_mut()?;
        let is_pass_due = match learner.stage() {
            Stage::Nothing => false,
            Stage::Rough if self.settings.learning == Learning::First => false,
            Stage::Rough => self.film.passes_min() == 0 || self.lead_seconds > 0.0 || is_late,
            Stage::Complete => true,
        };
        if is_pass_due {
            if is_late && learner.shows_all() {
                let known = learner.known().cloned();
                self.relight(known, Outdated::Rough);
            }
            return None;
        }
        let start = Instant::now();
        let is_first = learner.stage() == Stage::Nothing;
        let before = learner.counts();
        let is_better = learner.step(&self.world, cancel);
        let counts = learner.counts() - before;
        let known = learner.known().cloned();
        if is_better {
            self.relight(known, Outdated::Rough);
        }
        if !is_first {
            self.lead_seconds += start.elapsed().as_secs_f64();
        }
        self.counts += counts;
        Some(Progress { counts, complete: false })
    }

    fn is_late(&self) -> bool {
        matches!(self.settings.learning, Learning::Alongside { until: Some(moment) } if Instant::now() >= moment)
    }

    /// Goes on with what is known of the light by now; what was sampled of direct light stays.
    pub fn relight(&mut self, known: Option<Arc<dyn SecondaryLight>>, outdated: Outdated) {
        self.technique = Box::new(tracer(&self.settings, known));
        self.film.outdate_secondary(outdated);
    }

    /// All that is to be known of the light is known: the film is what further passes add to.
    pub fn knows_its_light(&self) -> bool {
        self.learner.as_ref().is_none_or(|learner| learner.stage() == Stage::Complete)
    }

    /// What its light was learnt with, where it learns by itself.
    pub fn illumination(&self) -> Option<&Illumination> {
        self.learner.as_ref()?.illumination()
    }

    /// What it knows of its light by now, where it learns by itself.
    pub fn known(&self) -> Option<&Arc<dyn SecondaryLight>> {
        self.learner.as_ref()?.known()
    }

    /// What its records of irradiance took, where it makes any.
    pub fn records(&self) -> RecordReport {
        self.learner.as_ref().map(|learner| learner.records()).unwrap_or_default()
    }

    /// The error of the picture, measured; `None` while it is unknown: below two passes, and for biased techniques, whose
    /// error is more than the noise that two halves of a film differ by.
    pub fn measured_error(&self) -> Option<MeasuredError> {
        let is_measurable = self.card().bias == Bias::Unbiased && !self.settings.indirect.is_learnt();
        is_measurable.then(|| self.film.measured_error()).flatten()
    }

    /// The picture so far.
    pub fn film(&self) -> &Film {
        &self.film
    }

    /// The world it shows.
    pub fn world(&self) -> &Arc<World> {
        &self.world
    }

    /// Work done so far.
    pub fn counts(&self) -> Counts {
        self.counts
    }

    /// Samples that every pixel has.
    pub fn passes(&self) -> u32 {
        self.film.passes_min()
    }

    /// The technique at work.
    pub fn card(&self) -> &'static Card {
        self.technique.card()
    }
}

/// The path tracer that draws with what is known.
fn tracer(settings: &RenderSettings, known: Option<Arc<dyn SecondaryLight>>) -> PathTracer {
    let classes = match settings.indirect {
        Indirect::Auto | Indirect::Path => PathClasses::All,
        Indirect::None | Indirect::Octree | Indirect::Irradiance => PathClasses::EmittedAndDirect,
    };
    let path = PathSettings { classes, bounces_max: settings.bounces_max, seed: settings.seed };
    match known.filter(|_| settings.indirect.is_learnt()) {
        Some(known) => PathTracer::with_secondary(path, known),
        None => PathTracer::new(path),
    }
}
