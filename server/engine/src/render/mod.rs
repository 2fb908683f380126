//! The progressive loop: a view of a world, a film, and the techniques that fill it.
//!
//! [`Illumination`] is what a scene knows of its light whoever looks: photons and the octree made of them, brought up to
//! date after edits; [`Learner`] adds what is gathered from it for those who look. [`Rendering`] is one view that draws with
//! what is known, and, where asked for the best there is, with path tracing beside it; `chain.rs` decides which comes next and
//! measures what comes of it. Imports every room to its left; the server talks to this one.

mod chain;
mod forecast;
mod hidden;
mod illumination;
mod learner;
#[cfg(test)]
mod tests;

use std::{
    sync::{Arc, atomic::AtomicBool},
    time::Instant,
};

use crate::{
    effects::{EffectChoices, EffectKind, EffectPlan},
    film::{Film, MeasuredError, Outdated, Picture, PictureSize},
    math::sobol,
    scene::CameraView,
    technique::{
        Canvas, Counts, Products, Progress, SecondaryLight, Step, Technique, View,
        caustics::{CausticReport, CausticSettings, CausticSketch, Caustics},
        path::{PathSettings, PathTracer},
    },
    transport::{PathClass, PathClasses, World},
};
use chain::{Measuring, Outlook, Shortfall, Spent, Turn};
use forecast::Way;
use hidden::{HiddenFor, HiddenHalves, HiddenLight};

pub use chain::MeasuringShare;
pub use forecast::{Expected, ForecastRecord, Forecasts, Remaining, When};
pub use illumination::{Illumination, IlluminationReport, IlluminationSettings, Stage};
pub use learner::{Learner, RecordReport};

/// Work on learning for each that goes into drawing while there is more to learn: before it is measured what the picture is
/// short of, and at least and at most afterwards.
const LEARNING_SHARE: f64 = 1.0;
const LEARNING_SHARES: [f64; 2] = [0.25, 5.0];

/// An error that is measured this many times that asked for may in truth be that already, where it is known badly.
const DOUBTED: f64 = 1.25;

/// Share of the path-traced film below which a picture does not show it, and above which it shows nothing else.
const SHARE_SHOWN: f64 = 0.01;

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

/// What is learnt of a scene's light.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Learnt {
    /// Photons and the octree made of them.
    Octree,
    /// Those, and records of irradiance gathered from them.
    Records,
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
    /// [learnt](Indirect::learns) it bounds what surfaces receive, whatever mirrors and glass lie between them and the eye.
    pub bounces_max: Option<u32>,
    /// Names the random numbers.
    pub seed: u64,
    /// When it is drawn.
    pub learning: Learning,
    /// Effects that are chosen in place of the plan.
    pub effects: EffectChoices,
    /// Time that measuring what is looked up may take, beside what [`Rendering::aim_at`] allows.
    pub measuring: MeasuringShare,
}

impl RenderSettings {
    /// Memory that a picture is to be given, about: that of its films, and of maps of caustics with as many photons as they may
    /// have.
    ///
    /// - `plan`: of the scene
    pub fn picture_bytes(&self, plan: &EffectPlan, pixel_count: usize) -> usize {
        let films = if self.indirect == Indirect::Auto { 2 } else { 1 };
        // Of hidden light each film has its own, and each half of the measure.
        let maps = usize::from(self.focuses(plan)) + 4 * usize::from(self.brings_hidden(plan));
        let of = CausticSettings::of(pixel_count, self.bounces_max, self.seed);
        let light = (maps * of.bytes_max()).max(CausticSketch::bytes_max(pixel_count));
        films * pixel_count * Film::BYTES_PER_PIXEL + if maps > 0 { light } else { 0 }
    }

    /// Light that comes by way of other surfaces is looked up, with an error that is more than noise.
    fn looks_up(&self) -> bool {
        match self.indirect {
            Indirect::Octree | Indirect::Irradiance => true,
            Indirect::Auto => self.bounces_max.is_none_or(|bounces| bounces > 1),
            Indirect::Path | Indirect::None => false,
        }
    }

    /// It also looks at light that comes by way of mirrors and glass.
    fn looks_further(&self) -> bool {
        self.looks_up() && self.bounces_max.is_none_or(|bounces| bounces > 1)
    }

    /// Photons of its own bring caustics.
    fn focuses(&self, plan: &EffectPlan) -> bool {
        self.looks_further() && self.effects.caustics.runs(plan.is_on(EffectKind::Caustics))
    }

    /// Photons bring what path tracing cannot find; also where caustics are turned off: what surfaces send on of them is indirect
    /// light.
    fn brings_hidden(&self, plan: &EffectPlan) -> bool {
        self.looks_further() && plan.is_on(EffectKind::Caustics) && plan.facts.hides_light()
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

/// A picture in the making.
pub struct Rendering {
    world: Arc<World>,
    view: View,
    film: Film,
    technique: PathTracer,
    /// Where light is looked up and the scene has caustics: what makes them.
    caustics: Option<Caustics>,
    /// What stands for them in the first pass.
    sketch: Option<Arc<CausticSketch>>,
    /// What path tracing cannot find of its light, for this film as long as nothing is known, and for the path-traced one.
    hidden: [Option<HiddenLight>; 2],
    /// Where the best there is is asked for: the path-traced film beside the one of looked-up light, once it has any sample.
    traced: Option<Film>,
    settings: RenderSettings,
    /// What its light is looked up in.
    learnt: Option<Learnt>,
    /// Light that there is in the scene, as far as it is to be seen: what is known may be of the scene before an edit.
    looked_up: PathClasses,
    /// What the light is learnt with, where no one else does.
    learner: Option<Box<Learner>>,
    /// Work on learning ahead of the share of it that was due when passes were drawn, in what [`Rendering::work`] counts.
    lead: f64,
    /// What the picture was last found to be short of, also of the light before it was known better.
    shortfall: Option<Shortfall>,
    /// Where light is looked up: what the error is measured with, and what was found.
    measuring: Option<Measuring>,
    outlook: Option<Outlook>,
    /// The error asked for, √relMSE.
    target: Option<f64>,
    /// By what is known the picture may have it, but not surely.
    is_doubted: bool,
    /// Drawn since measuring was last granted as much.
    ungranted_rays: u64,
    counts: Counts,
    /// Rays of either film.
    looked_up_rays: u64,
    traced_rays: u64,
}

impl std::fmt::Debug for Rendering {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Rendering").field("settings", &self.settings).field("counts", &self.counts).finish()
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
        Rendering::learning_by((world, IlluminationSettings::of(&settings)), view, size, settings)
    }

    /// The same, learning by settings of its own.
    pub fn learning_by(
        (world, illumination): (Arc<World>, IlluminationSettings),
        view: CameraView,
        size: PictureSize,
        settings: RenderSettings,
    ) -> Rendering {
        let plan = EffectPlan::of(world.scene());
        let rendering = Rendering::with((world, &plan), view, size, settings, None);
        let learner = rendering.learnt.map(|learnt| {
            let mut learner = Learner::new(learnt, &settings, illumination);
            learner.look(0, &view, size);
            Box::new(learner)
        });
        Rendering { learner, ..rendering }
    }

    /// An empty film of `view` that is drawn with what is known of the scene's light; by octree and records light that comes
    /// by way of other surfaces is missing where nothing is known.
    ///
    /// - `plan`: of the world's scene
    pub fn with(
        (world, plan): (Arc<World>, &EffectPlan),
        view: CameraView,
        size: PictureSize,
        settings: RenderSettings,
        known: Option<Arc<dyn SecondaryLight>>,
    ) -> Rendering {
        let learnt = settings.learns(plan);
        let of = CausticSettings::of(size.pixel_count(), settings.bounces_max, settings.seed);
        let caustics = settings.focuses(plan).then(|| Caustics::new(of));
        let brings_hidden = settings.brings_hidden(plan);
        let hidden = |what_for| brings_hidden.then(|| HiddenLight::new(&settings, size, what_for));
        // What is sampled alone says by its two halves how far off it is.
        let all = settings.effects.shown();
        let looked_up = if plan.is_on(EffectKind::Caustics) { all } else { all.without(PathClass::Caustic) };
        let is_gauged = learnt.is_some() || caustics.is_some();
        let measured = is_gauged.then(|| hidden(HiddenFor::Measure).map(HiddenHalves::new));
        Rendering {
            view: View::new(&world, &view, size),
            world,
            film: Film::new(size),
            technique: tracer(&settings, looked_up, learnt, known),
            learnt,
            looked_up,
            caustics,
            sketch: None,
            hidden: [HiddenFor::LookedUp, HiddenFor::Traced].map(hidden),
            traced: None,
            settings,
            learner: None,
            lead: 0.0,
            shortfall: None,
            measuring: measured
                .map(|hidden| Measuring::new(all_paths(&settings), size, settings.measuring, hidden)),
            outlook: None,
            target: None,
            is_doubted: false,
            ungranted_rays: 0,
            counts: Counts::default(),
            looked_up_rays: 0,
            traced_rays: 0,
        }
    }

    /// A sketch of the caustics would be shown: there are any, and nothing is drawn yet.
    pub fn takes_sketch(&self) -> bool {
        self.caustics.is_some() && self.technique.asks() && self.film.passes_max() == 0
    }

    /// Draws the first pass with a sketch of the caustics instead of waiting for photons of its own, if it
    /// [takes one](Rendering::takes_sketch); the next one replaces them.
    pub fn begin_with(&mut self, sketch: Arc<CausticSketch>) {
        if self.takes_sketch() {
            self.sketch = Some(sketch);
        }
    }

    /// One step of the technique on the rayon pool it is called in; ends early, between tiles, once `cancel` is true.
    /// The films are valid after every step, cancelled or not.
    pub fn step(&mut self, cancel: &AtomicBool) -> Progress {
        if let Some(progress) = self.learn(cancel).or_else(|| self.settle_doubt(cancel)) {
            return progress;
        }
        let is_first = self.film.passes_min() == 0;
        let (start, before) = (Instant::now(), self.counts);
        let progress = match self.turn() {
            Turn::LookedUp => self.draw(cancel),
            Turn::Traced => self.trace(cancel),
        };
        self.counts += progress.counts;
        self.lead -= self.learning_share() * self.work(start, before);
        // Whoever waits for a first picture waits for nothing else.
        self.ungranted_rays += progress.counts.all_rays();
        if progress.complete && !is_first {
            let drawn = std::mem::take(&mut self.ungranted_rays);
            if let Some(measuring) = self.measuring.as_mut().filter(|_| self.is_doubted) {
                measuring.grant(drawn);
            }
            self.measure(cancel);
        }
        Progress { counts: self.counts - before, ..progress }
    }

    /// A pass of the film that is drawn with what is known.
    fn draw(&mut self, cancel: &AtomicBool) -> Progress {
        let pass = pass_of(&self.film);
        let withdrawn = self.sketch.take_if(|_| pass > 0 || !self.technique.asks());
        if withdrawn.is_some() {
            self.film.outdate(&[PathClass::Caustic], Outdated::Wrong);
        }
        let sketched = self.sketch.as_ref().and_then(|sketch| sketch.seen_by(&self.view));
        let (products, prepared) = match (&mut self.caustics, sketched) {
            (Some(_), Some(caustics)) => {
                let seen = Products { caustics: Some(caustics), ..Products::default() };
                (seen, Progress { complete: true, ..Progress::default() })
            }
            (Some(caustics), _) if self.technique.asks() => {
                let progress = caustics.prepare(&self.world, pass, cancel);
                (Products { caustics: caustics.map(), ..Products::default() }, progress)
            }
            _ => hidden_light(&mut self.hidden[0], &self.world, pass, cancel),
        };
        let progress = step_on(
            &mut self.technique,
            (&self.world, &self.view),
            &mut self.film,
            products,
            prepared,
            cancel,
        );
        self.looked_up_rays += progress.counts.all_rays();
        progress
    }

    /// A pass of the path-traced film.
    fn trace(&mut self, cancel: &AtomicBool) -> Progress {
        let size = self.film.size();
        let film = self.traced.get_or_insert_with(|| Film::new(size));
        let (products, prepared) = hidden_light(&mut self.hidden[1], &self.world, pass_of(film), cancel);
        // With numbers of its own: its samples are independent of the other film's.
        let settings = all_paths(&self.settings);
        let settings = PathSettings { seed: sobol::mix(settings.seed ^ 0x0070_6174_6800), ..settings };
        let mut technique = PathTracer::new(settings);
        let progress = step_on(&mut technique, (&self.world, &self.view), film, products, prepared, cancel);
        self.traced_rays += progress.counts.all_rays();
        progress
    }

    /// Which film is drawn next.
    fn turn(&mut self) -> Turn {
        if self.settings.indirect != Indirect::Auto || self.film.passes_min() == 0 {
            return Turn::LookedUp;
        }
        // A pass that was begun is ended first.
        if self.film.passes_min() != self.film.passes_max() {
            return Turn::LookedUp;
        }
        if self.traced.as_ref().is_some_and(|film| film.passes_min() != film.passes_max()) {
            return Turn::Traced;
        }
        let Some(outlook) = self.outlook else { return Turn::LookedUp };
        if self.knows_its_light() || self.is_late() {
            return outlook.turn();
        }
        let spent = self.counts.all_rays();
        // What is learnt makes the picture better by nobody knows how much: path tracing gets half of the work if it would
        // have done better with all of it.
        let is_behind = outlook.tracing_would_have_done(spent);
        if is_behind && 2 * self.traced_rays < spent { Turn::Traced } else { Turn::LookedUp }
    }

    /// Measures on where that was cut short before it had as much work as drawing; `None` when it has had that.
    fn settle_doubt(&mut self, cancel: &AtomicBool) -> Option<Progress> {
        let spent = self.counts.all_rays();
        self.measuring.as_ref().filter(|measuring| self.is_doubted && measuring.is_owed(spent))?;
        let before = self.counts;
        self.measure(cancel);
        let counts = self.counts - before;
        (counts.all_rays() > 0).then_some(Progress { counts, complete: false })
    }

    /// Keeps the measure of the error up with the rest of the work.
    fn measure(&mut self, cancel: &AtomicBool) {
        let Some(measuring) = &mut self.measuring else { return };
        let spent = self.counts.all_rays();
        self.counts += measuring.keep_up((&self.world, &self.view), &self.film, spent, cancel);
        let looked_up = Spent { passes: self.film.passes_min(), rays: self.looked_up_rays };
        let traced = self.traced.as_ref().map(|film| {
            let spent = Spent { passes: film.passes_min(), rays: self.traced_rays };
            (film, spent)
        });
        let samples = looked_up.passes + traced.map_or(0, |(_, spent)| spent.passes);
        if self.outlook.is_none_or(|outlook| outlook.is_due(samples)) {
            self.outlook = Outlook::of((&self.film, looked_up), traced, measuring);
            self.shortfall = self.outlook.map(|outlook| outlook.shortfall()).or(self.shortfall);
            self.is_doubted = self.is_doubtful();
            if let Some(measuring) = self.measuring.as_mut().filter(|_| !self.is_doubted) {
                measuring.forget_grants(self.counts.all_rays());
            }
        }
    }

    /// The picture may be as good as asked for, and only the measure is too uncertain to say so: then measuring gets as much work
    /// as drawing.
    fn is_doubtful(&self) -> bool {
        let Some(target) = self.target.filter(|_| self.knows_its_light()) else { return false };
        let measured = self.measured_error();
        measured.is_some_and(|measured| measured.error() <= DOUBTED * target && !measured.reaches(target))
    }

    /// The picture is to have this error (√relMSE), if any: whether it has is then found out with more than the usual share.
    pub fn aim_at(&mut self, target: Option<f64>) {
        if self.target != target {
            (self.target, self.is_doubted) = (target, false);
        }
    }

    /// Work on learning for each on drawing, by what the picture is short of.
    fn learning_share(&self) -> f64 {
        let [least, most] = LEARNING_SHARES;
        self.shortfall.map_or(LEARNING_SHARE, |found| found.learning_share()).clamp(least, most)
    }

    /// Learns of the scene's light; `None` when a pass is due. The first pass is drawn with the first rough answer; then
    /// both go on beside each other until all is known. What is sampled of direct light is kept throughout.
    fn learn(&mut self, cancel: &AtomicBool) -> Option<Progress> {
        let is_late = self.is_late();
        let learner = self.learner.as_mut()?;
        let is_pass_due = match learner.stage() {
            Stage::Nothing => false,
            Stage::Rough if self.settings.learning == Learning::First => false,
            Stage::Rough => self.film.passes_min() == 0 || is_late || self.lead > 0.0,
            Stage::Complete => true,
        };
        if is_pass_due {
            if is_late && learner.shows_all() {
                let known = learner.known().cloned();
                self.relight(known, Outdated::Rough);
            }
            return None;
        }
        let (start, counts_before) = (Instant::now(), self.counts);
        let is_first = learner.stage() == Stage::Nothing;
        let before = learner.counts();
        let is_better = learner.step(&self.world, cancel);
        let counts = learner.counts() - before;
        let known = learner.known().cloned();
        if is_better {
            self.relight(known, Outdated::Rough);
        }
        self.counts += counts;
        if !is_first {
            self.lead += self.work(start, counts_before);
        }
        Some(Progress { counts, complete: false })
    }

    /// What was done since then, in seconds, or in rays where no clock may decide.
    fn work(&self, start: Instant, before: Counts) -> f64 {
        match self.settings.learning {
            Learning::Alongside { .. } => start.elapsed().as_secs_f64(),
            Learning::First | Learning::InStep => (self.counts - before).all_rays() as f64,
        }
    }

    fn is_late(&self) -> bool {
        matches!(self.settings.learning, Learning::Alongside { until: Some(moment) } if Instant::now() >= moment)
    }

    /// Lets what is known of the light answer for caustics as well, instead of photons of their own: for measuring it.
    pub fn look_caustics_up(&mut self) {
        self.caustics = None;
    }

    /// Goes on with what is known of the light by now; what was sampled of direct light stays.
    pub fn relight(&mut self, known: Option<Arc<dyn SecondaryLight>>, outdated: Outdated) {
        self.technique = tracer(&self.settings, self.looked_up, self.learnt, known);
        // Caustics of their own do not depend on what is known, but on the scene.
        let classes: &[PathClass] = match (&self.caustics, outdated) {
            (Some(_), Outdated::Rough) => &[PathClass::Indirect],
            _ => &[PathClass::Indirect, PathClass::Caustic],
        };
        self.film.outdate(classes, outdated);
        // Found of the light before.
        self.outlook = None;
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

    /// What its caustics took and hold.
    pub fn caustics(&self) -> CausticReport {
        let hidden = self.hidden.iter().flatten().map(HiddenLight::report);
        let measured =
            self.measuring.iter().flat_map(|measuring| &measuring.hidden).map(HiddenHalves::report);
        let own = self.caustics.iter().map(Caustics::report);
        own.chain(hidden).chain(measured).fold(CausticReport::default(), |sum, report| sum + report)
    }

    /// The error of the picture, measured; `None` while it is unknown. Of path tracing, by what the two halves of its film
    /// differ; of looked-up light, by path tracing some pixels, or, once that knows better, by the path-traced film in it.
    /// Takes some tenths of a microsecond a pixel: ask a few times a second, not for every frame.
    pub fn measured_error(&self) -> Option<MeasuredError> {
        self.measured_error_of(&self.picture())
    }

    /// The same, of what [`Rendering::picture`] returned.
    pub fn measured_error_of(&self, picture: &Picture<'_>) -> Option<MeasuredError> {
        let Some(measuring) = &self.measuring else { return self.film.measured_error() };
        let by_either = [measuring.error_of(picture, &self.film), picture.measured_error()];
        by_either.into_iter().flatten().reduce(MeasuredError::surer)
    }

    /// What is left to do until the picture has an error (√relMSE); `None` where that cannot be told.
    ///
    /// - `measured`: its error now
    /// - `learns`: others learn more of its light
    pub fn remaining(&self, measured: &MeasuredError, target: f64, learns: bool) -> Option<Remaining> {
        if measured.reaches(target) {
            return Some(Remaining::Nothing);
        }
        let rays = self.counts.all_rays() as f64;
        let passes = f64::from(self.passes());
        match &self.outlook {
            Some(outlook) if !learns && self.knows_its_light() => {
                let way = Way {
                    outlook,
                    measured,
                    target,
                    rays,
                    measuring_share: self.settings.measuring.of_rays(),
                    is_aimed_at: self.target.is_some_and(|own| (own - target).abs() < 1e-6),
                    traces: self.settings.indirect == Indirect::Auto,
                };
                way.remaining()
            }
            // Noise falls as one over the work, and so about does what is not known yet of the light.
            _ => forecast::as_noise(measured, target, rays, passes),
        }
    }

    /// Light is looked up in what was learnt, and the error measured against path tracing of some pixels.
    pub fn is_looked_up(&self) -> bool {
        self.measuring.is_some()
    }

    /// Neither learning nor samples will make the error that is left noticeably smaller: it is the technique's own.
    pub fn is_at_its_best(&self) -> bool {
        let is_biased = matches!(self.settings.indirect, Indirect::Octree | Indirect::Irradiance);
        is_biased && self.knows_its_light() && self.outlook.is_some_and(|outlook| outlook.is_at_its_floor())
    }

    /// The picture so far.
    pub fn picture(&self) -> Picture<'_> {
        match &self.traced {
            Some(traced) => Picture::blended(&self.film, traced),
            None => Picture::of(&self.film),
        }
    }

    /// The film that is drawn with what is known of the light: all of the picture, but for path tracing beside it.
    pub fn film(&self) -> &Film {
        &self.film
    }

    /// Its size.
    pub fn size(&self) -> PictureSize {
        self.film.size()
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
        self.films().map(Film::passes_min).sum()
    }

    /// Every pixel has as many.
    pub fn is_whole(&self) -> bool {
        self.films().all(|film| film.passes_min() == film.passes_max())
    }

    /// Samples of all pixels together.
    pub fn sample_count(&self) -> u64 {
        self.films().map(Film::sample_count).sum()
    }

    /// Samples that were not finite or negative, and count as black.
    pub fn dropped_samples(&self) -> u64 {
        self.films().map(Film::dropped_samples).sum()
    }

    /// Memory of its films.
    pub fn film_bytes(&self) -> usize {
        self.films().map(Film::bytes).sum()
    }

    fn films(&self) -> impl Iterator<Item = &Film> {
        std::iter::once(&self.film).chain(&self.traced)
    }

    /// Name of what a picture that [`Rendering::picture`] returned is made by.
    pub fn technique_name(&self, picture: &Picture<'_>) -> &'static str {
        let looked_up = match &self.caustics {
            Some(_) if self.learnt.is_none() => "caustics",
            _ => self.technique.card().name,
        };
        match (picture.traced_share(), looked_up) {
            (share, _) if share < SHARE_SHOWN => looked_up,
            (share, _) if share > 1.0 - SHARE_SHOWN => "path",
            (_, "octree") => "octree+path",
            (_, "irradiance") => "irradiance+path",
            (_, "caustics") => "caustics+path",
            (_, _) => "path",
        }
    }
}

/// The pass that comes next on a film, or that was cut short.
fn pass_of(film: &Film) -> u32 {
    film.passes_min()
}

/// What a path-traced pass cannot find by itself.
fn hidden_light(
    hidden: &mut Option<HiddenLight>,
    world: &World,
    pass: u32,
    cancel: &AtomicBool,
) -> (Products, Progress) {
    match hidden {
        None => (Products::default(), Progress { complete: true, ..Progress::default() }),
        Some(hidden) => {
            let progress = hidden.prepare(world, pass, cancel);
            (hidden.products(), progress)
        }
    }
}

/// A pass of a film with what was prepared for it, once that is complete.
fn step_on(
    technique: &mut PathTracer,
    (world, view): (&World, &View),
    film: &mut Film,
    mut products: Products,
    prepared: Progress,
    cancel: &AtomicBool,
) -> Progress {
    if !prepared.complete {
        return prepared;
    }
    let canvas = Some(Canvas { view, film });
    let progress = technique.step(&mut Step { world, products: &mut products, canvas, cancel });
    Progress { counts: prepared.counts + progress.counts, ..progress }
}

/// Settings of a path tracer of all that is to be seen.
fn all_paths(settings: &RenderSettings) -> PathSettings {
    let shown = settings.effects.shown();
    PathSettings { shown, traced: shown, ..PathSettings::all(settings.bounces_max, settings.seed) }
}

/// The path tracer that draws with what is known; where the best there is is asked for and nothing is known yet, by itself.
///
/// - `looked_up`: what is shown of what others know
fn tracer(
    settings: &RenderSettings,
    looked_up: PathClasses,
    learnt: Option<Learnt>,
    known: Option<Arc<dyn SecondaryLight>>,
) -> PathTracer {
    let path = all_paths(settings);
    let asks = match settings.indirect {
        Indirect::None | Indirect::Octree | Indirect::Irradiance => true,
        Indirect::Auto => settings.looks_up() && learnt.is_none(),
        Indirect::Path => false,
    };
    match known.filter(|_| learnt.is_some()) {
        Some(known) => PathTracer::with_secondary(PathSettings { shown: looked_up, ..path }, known),
        None if asks => PathTracer::new(PathSettings { shown: looked_up, ..path }.asking()),
        None => PathTracer::new(path),
    }
}
