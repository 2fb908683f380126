//! The progressive loop: a view of a world, a film, and the techniques that fill it.
//!
//! [`Illumination`] is what a scene knows of its light whoever looks: photons and the octree made of them, brought up to
//! date after edits; [`Learner`] adds what is gathered from it for those who look. [`Rendering`] is one view that draws with
//! what is known, and, where asked for the best there is, with path tracing beside it; `chain.rs` decides which comes next, by how noisy
//! either is (`noises.rs`); `measuring.rs` measures what comes of it, `learning.rs` shares the work between learning and drawing,
//! `meanwhile.rs` before anything is known, `accuracy.rs` says how good the picture is, and `forecast.rs` when it will be better; `settings.rs` is what
//! is asked for, `told.rs` what a rendering tells of itself. Imports every room to its left; the server talks to this one.

mod accuracy;
#[cfg(feature = "gpu")]
mod backend;
mod chain;
mod forecast;
mod hidden;
mod illumination;
mod learner;
mod learning;
mod meanwhile;
mod measuring;
mod noises;
mod remaining;
mod settings;
mod sketched;
#[cfg(test)]
mod tests;
mod told;

use std::sync::{Arc, atomic::AtomicBool};

use glam::{UVec2, Vec3};
use rayon::prelude::*;

#[cfg(feature = "gpu")]
use crate::gpu::GpuError;
use crate::{
    accel::Ray,
    effects::{EffectKind, EffectPlan},
    film::{Denoising, Film, Outdated, Picture, PictureSize},
    math::sobol,
    scene::CameraView,
    technique::{
        Canvas, Counts, Products, Progress, SecondaryLight, Step, Technique, View,
        caustics::{CausticReport, CausticSettings, CausticSketch, Caustics},
        path::{PathSettings, PathTracer},
    },
    transport::{PathClass, PathClasses, ShadowRay, World},
};
#[cfg(feature = "gpu")]
use backend::OnGpu;
use chain::{Outlook, Turn, Work};
use hidden::{HiddenFor, HiddenHalves, HiddenLight};
use learning::Course;
use measuring::Measuring;
use sketched::{Seen, Sketched};

#[cfg(feature = "gpu")]
pub use backend::BackendTrial;
pub use forecast::{Expected, ForecastRecord, Forecasts, When};
pub use illumination::{Illumination, IlluminationReport, IlluminationSettings, Stage};
pub use learner::{Learner, RecordReport};
pub use measuring::MeasuringShare;
pub use remaining::{Remaining, ToLearn};
pub use settings::{Backend, Indirect, Learning, Learnt, RenderSettings};

/// Passes that are drawn with light that is better known before path tracing may have its turn: as many as the light before counts for.
const PASSES_AFRESH: u32 = 2;

/// A place is seen where nothing lies this share of the way nearer.
const PLACE_SLACK: f32 = 1e-3;

/// The picture that a film shows by itself.
fn own_picture<'a>(film: &'a Film, denoising: Option<&Denoising>) -> Picture<'a> {
    let picture = Picture::of(film);
    match denoising {
        Some(denoising) => picture.denoised(denoising),
        None => picture,
    }
}

/// A picture in the making.
pub struct Rendering {
    world: Arc<World>,
    view: View,
    film: Film,
    /// Of the film as it is.
    denoising: Denoising,
    /// Something scatters diffusely.
    has_diffuse: bool,
    technique: PathTracer,
    /// Seconds that laying known light out over the picture took by what drew before, of all threads.
    splat_seconds: f64,
    /// What draws in its place on a graphics card.
    #[cfg(feature = "gpu")]
    gpu: Option<Box<OnGpu>>,
    /// Why nothing does any more.
    #[cfg(feature = "gpu")]
    gpu_failure: Option<GpuError>,
    #[cfg(feature = "gpu")]
    gpu_passes: u64,
    #[cfg(feature = "gpu")]
    gpu_gathered_rays: u64,
    /// Photons that a card carried.
    #[cfg(feature = "gpu")]
    gpu_carried_photons: u64,
    /// Where light is looked up and the scene has caustics: what makes them.
    caustics: Option<Caustics>,
    /// What stands for them in the first pass.
    sketch: Option<Sketched>,
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
    /// Where learning stands beside drawing.
    course: Course,
    /// Seconds of the last pass and of measuring after it.
    pass_seconds: f64,
    /// Work on learning for each on drawing, by what the picture was last found to be short of, also of the light before it was known better.
    share_found: Option<f64>,
    /// Rays that had been spent when records of its own were first measured, while they are made.
    records_since: Option<u64>,
    /// Where light is looked up: what the error is measured with, and what was found.
    measuring: Option<Measuring>,
    outlook: Option<Outlook>,
    /// Passes of the film when what is known of the light last became better.
    relit_at: u32,
    /// The error asked for, √relMSE.
    target: Option<f64>,
    /// By what is known the picture may have it, but not surely.
    is_doubted: bool,
    /// It was last found to have it, by pixels that were taken after it first seemed so as well.
    is_confirmed: bool,
    /// Drawn since measuring was last granted as much.
    ungranted_rays: u64,
    counts: Counts,
    /// Rays that the CPU would have traced in the time that cards took, less those that the cards traced.
    surplus_rays: i64,
    /// Rays of either film, as the CPU counts them.
    looked_up_rays: u64,
    traced_rays: u64,
    /// Its work by what it went into, for deciding what comes next.
    done: Work,
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
        match settings.learns(&plan) {
            Some(learnt) => {
                let learner = Learner::new(learnt, &settings, illumination);
                let mut rendering =
                    Rendering::learning_on((world, &plan), (learner, 0), (view, size), settings);
                rendering.course.awaiting.is_alone = true;
                rendering
            }
            None => Rendering::with((world, &plan), view, size, settings, None),
        }
    }

    /// The same, going on from what somebody else learnt of the world's light.
    ///
    /// - `plan`: of the world's scene
    /// - `learner`: of what pictures with these settings [learn](RenderSettings::learns), and what it is to know the view by
    pub fn learning_on(
        (world, plan): (Arc<World>, &EffectPlan),
        (mut learner, gaze): (Learner, u64),
        seen: (CameraView, PictureSize),
        settings: RenderSettings,
    ) -> Rendering {
        learner.look_away(|_| false);
        Rendering::learning_with((world, plan), (learner, gaze), seen, settings)
    }

    /// The same, beside others who look and for whom it goes on, in turn ([`Rendering::lend_learner`], [`Rendering::go_on_with`]).
    ///
    /// - `learner`: as above; none of the others is known to it by this name
    pub fn learning_with(
        (world, plan): (Arc<World>, &EffectPlan),
        (mut learner, gaze): (Learner, u64),
        (view, size): (CameraView, PictureSize),
        settings: RenderSettings,
    ) -> Rendering {
        learner.go_on_for(settings.learning);
        learner.look(gaze, &view, size);
        let known = learner.known().cloned();
        let rendering = Rendering::with((world, plan), view, size, settings, known);
        Rendering { learner: Some(Box::new(learner)), ..rendering }
    }

    /// An empty film of `view` that is drawn with what is known of the scene's light. Where nothing is known, light that comes by way of
    /// other surfaces is path-traced for who watches, and by the best there is; in a single picture by octree or records it is missing.
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
        let seen_by = View::new(&world, &view, size);
        let passes_by_flux = u32::from(settings.is_watched());
        let of = CausticSettings { seen_by: Some(seen_by), passes_by_flux, ..of };
        let caustics = settings.focuses(plan).then(|| Caustics::new(of));
        let brings_hidden = settings.brings_hidden(plan);
        let hidden = |what_for| brings_hidden.then(|| HiddenLight::new(&settings, (seen_by, size), what_for));
        // What is sampled alone says by its two halves how far off it is.
        let all = settings.effects.shown();
        let looked_up = if plan.is_on(EffectKind::Caustics) { all } else { all.without(PathClass::Caustic) };
        let is_gauged = learnt.is_some() || caustics.is_some();
        let measured = is_gauged.then(|| hidden(HiddenFor::Measure).map(HiddenHalves::new));
        Rendering {
            view: View::new(&world, &view, size),
            world,
            film: if settings.notes_beyond(plan) { Film::new(size) } else { Film::unfiltered(size) },
            denoising: Denoising::default(),
            has_diffuse: plan.facts.diffuse > 0,
            technique: tracer(&settings, looked_up, learnt, known),
            splat_seconds: 0.0,
            #[cfg(feature = "gpu")]
            gpu: None,
            #[cfg(feature = "gpu")]
            gpu_failure: None,
            #[cfg(feature = "gpu")]
            gpu_passes: 0,
            #[cfg(feature = "gpu")]
            gpu_gathered_rays: 0,
            #[cfg(feature = "gpu")]
            gpu_carried_photons: 0,
            learnt,
            looked_up,
            caustics,
            sketch: None,
            hidden: [HiddenFor::LookedUp, HiddenFor::Traced].map(hidden),
            traced: None,
            settings,
            learner: None,
            course: Course::default(),
            pass_seconds: 0.0,
            share_found: None,
            records_since: None,
            measuring: measured
                .map(|hidden| Measuring::new(all_paths(&settings), size, settings.measuring, hidden)),
            outlook: None,
            relit_at: 0,
            target: None,
            is_doubted: false,
            is_confirmed: false,
            ungranted_rays: 0,
            counts: Counts::default(),
            surplus_rays: 0,
            looked_up_rays: 0,
            traced_rays: 0,
            done: Work::default(),
        }
    }

    /// A sketch of the caustics would be shown: there are any, and nothing is drawn yet.
    pub fn takes_sketch(&self) -> bool {
        self.caustics.is_some() && self.technique.asks() && self.film.passes_max() == 0
    }

    /// Draws the first pass with a sketch of the caustics instead of waiting for photons of its own, if it
    /// [takes one](Rendering::takes_sketch); the next one replaces them.
    pub fn begin_with(&mut self, sketch: Arc<CausticSketch>) {
        if self.takes_sketch() && !self.sketch.as_ref().is_some_and(|own| own.is_of(&sketch)) {
            self.sketch = Some(Sketched::new(sketch));
        }
    }

    /// One step of the technique on the rayon pool it is called in; ends early, between tiles, once `cancel` is true.
    /// The films are valid after every step, cancelled or not.
    pub fn step(&mut self, cancel: &AtomicBool) -> Progress {
        let learnt = if self.traces_before_learning() { None } else { self.learn(cancel) };
        if let Some(progress) = learnt.or_else(|| self.settle_doubt(cancel)) {
            return progress;
        }
        let is_first = self.film.passes_min() == 0;
        let before = self.counts;
        // Whoever looks at a large picture in slices of time is not to wait for the end of its second pass.
        if !is_first && !self.is_whole() {
            self.keep_measuring_up(cancel);
        }
        let begun = self.begin();
        let turn = self.turn();
        let progress = match turn {
            Turn::LookedUp => self.draw(cancel),
            Turn::Traced => self.trace(cancel),
        };
        self.counts += progress.counts;
        let work = self.work_since(&begun);
        self.done.all += work;
        match turn {
            Turn::LookedUp => {
                self.done.looked_up += work;
                self.note_looked_up(work);
            }
            Turn::Traced => self.done.traced += work,
        }
        // Whoever waits for a first picture waits for nothing else.
        self.ungranted_rays += self.spent_rays().saturating_sub(begun.spent_rays);
        if progress.complete && !is_first {
            let drawn = std::mem::take(&mut self.ungranted_rays);
            if let Some(measuring) = self.measuring.as_mut().filter(|_| self.is_doubted) {
                measuring.grant(drawn);
            }
            match self.traces_meanwhile() {
                // What comes next is not decided by it.
                true => self.keep_measuring_up(cancel),
                false => self.measure(cancel),
            }
        }
        self.pass_seconds = begun.start.elapsed().as_secs_f64();
        Progress { counts: self.counts - before, ..progress }
    }

    /// A pass of the film that is drawn with what is known.
    fn draw(&mut self, cancel: &AtomicBool) -> Progress {
        self.denoising = Denoising::default();
        let pass = pass_of(&self.film);
        let withdrawn = self.sketch.take_if(|_| pass > 0 || !self.technique.asks());
        if withdrawn.is_some() {
            self.film.outdate(&[PathClass::Caustic], Outdated::Wrong);
        }
        let Seen { light: sketched, is_on_card } = self.seen_of_sketch().unwrap_or_default();
        // What the CPU sees of a sketch is not looked up on a card.
        let is_for_cpu = sketched.is_some() && !is_on_card;
        let (mut products, prepared) = match (&mut self.caustics, sketched) {
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
        self.looked_up_rays += prepared.counts.all_rays();
        if !prepared.complete {
            return prepared;
        }
        if self.caustics.as_mut().is_some_and(|caustics| self.technique.asks() && caustics.takes_back()) {
            self.film.outdate(&[PathClass::Caustic], Outdated::Wrong);
        }
        let on_gpu = if is_for_cpu { None } else { self.draw_on_gpu(&mut products, cancel) };
        let progress = on_gpu.unwrap_or_else(|| {
            let of = (&*self.world, &self.view);
            let progress = step_on(&mut self.technique, of, &mut self.film, &mut products, cancel);
            self.looked_up_rays += progress.counts.all_rays();
            progress
        });
        if progress.complete
            && let Some(sketch) = &mut self.sketch
        {
            sketch.end();
        }
        Progress { counts: prepared.counts + progress.counts, ..progress }
    }

    /// Photons, and what is known of where the sky shows, say where path-traced samples go, of the film and of the measure of the error alike: by
    /// the noise of the one it is judged what the other is worth. On a card they go without.
    fn is_guided(&self) -> bool {
        #[cfg(feature = "gpu")]
        return self.gpu.is_none();
        #[cfg(not(feature = "gpu"))]
        return true;
    }

    /// A pass of the path-traced film.
    fn trace(&mut self, cancel: &AtomicBool) -> Progress {
        let size = self.film.size();
        let pass = pass_of(self.traced.get_or_insert_with(|| Film::unfiltered(size)));
        let (mut products, prepared) = hidden_light(&mut self.hidden[1], &self.world, pass, cancel);
        self.traced_rays += prepared.counts.all_rays();
        if !prepared.complete {
            return prepared;
        }
        let progress = self.trace_on_gpu(&mut products, cancel).unwrap_or_else(|| {
            let film = self.traced.get_or_insert_with(|| Film::unfiltered(size));
            let known = self.technique.secondary().cloned();
            let mut technique = PathTracer::new(beside(&self.settings)).guided_by(known);
            let progress = step_on(&mut technique, (&self.world, &self.view), film, &mut products, cancel);
            self.traced_rays += progress.counts.all_rays();
            progress
        });
        Progress { counts: prepared.counts + progress.counts, ..progress }
    }

    /// Nothing draws but the CPU.
    #[cfg(not(feature = "gpu"))]
    fn draw_on_gpu(&mut self, _products: &mut Products, _cancel: &AtomicBool) -> Option<Progress> {
        None
    }

    /// Nothing draws but the CPU.
    #[cfg(not(feature = "gpu"))]
    fn trace_on_gpu(&mut self, _products: &mut Products, _cancel: &AtomicBool) -> Option<Progress> {
        None
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
        if self.traces_meanwhile() {
            return Turn::Traced;
        }
        // What the film tells before is what was known before, however much better that is by now: path tracing, once it seemed the better of
        // the two, would go on for ever where each of its passes lasts until more is known.
        if self.film.passes_min() < self.relit_at + PASSES_AFRESH {
            return Turn::LookedUp;
        }
        let Some(outlook) = self.outlook else { return Turn::LookedUp };
        if !self.is_learning() {
            return outlook.turn();
        }
        if outlook.is_for_tracing(&self.done) { Turn::Traced } else { Turn::LookedUp }
    }

    /// Lets what is known of the light answer for caustics as well, instead of photons of their own: for measuring it.
    pub fn look_caustics_up(&mut self) {
        self.caustics = None;
    }

    /// What its caustics took and hold.
    pub fn caustics(&self) -> CausticReport {
        let hidden = self.hidden.iter().flatten().map(HiddenLight::report);
        let measured =
            self.measuring.iter().flat_map(|measuring| &measuring.hidden).map(HiddenHalves::report);
        let own = self.caustics.iter().map(Caustics::report);
        own.chain(hidden).chain(measured).fold(CausticReport::default(), |sum, report| sum + report)
    }

    /// Seconds that records were splatted, of all threads.
    pub fn splat_seconds(&self) -> f64 {
        self.splat_seconds + self.technique.splat_seconds()
    }

    /// What takes noise off the film: where its light is, or will be, looked up, and its error is measured with what that blurs in it. Not
    /// where nothing is diffuse, and so nothing can be looked up, whatever effects are forced on.
    fn denoises(&self) -> Option<Denoising> {
        let is_filtered = self.is_looked_up() && self.has_diffuse && self.settings.takes_noise_off();
        is_filtered.then(|| self.denoising.clone())
    }

    /// The picture without path tracing beside it.
    fn own_picture(&self) -> Picture<'_> {
        own_picture(&self.film, self.denoises().as_ref())
    }

    /// The picture so far.
    pub fn picture(&self) -> Picture<'_> {
        let picture = self.own_picture();
        match &self.traced {
            Some(traced) => picture.blended(traced),
            None => picture,
        }
    }

    /// Pixels in which the places show where what it is drawn with was gathered, where the camera sees them straight.
    pub fn places_seen(&self) -> Vec<UVec2> {
        let Some(known) = self.technique.secondary() else { return Vec::new() };
        let size = self.film.size();
        let seen_at = |place: &Vec3| {
            let [x, y] = self.view.project(*place)?;
            let is_inside =
                (0.0..size.width() as f32).contains(&x) && (0.0..size.height() as f32).contains(&y);
            let ray = self.view.ray(x, y);
            // A little before the surface that the place is on.
            let t_max = (*place - ray.origin).dot(ray.direction) * (1.0 - PLACE_SLACK);
            let shadow_ray = ShadowRay { ray: Ray { t_max, ..ray }, light: None };
            (is_inside && !self.world.is_occluded(&shadow_ray)).then(|| UVec2::new(x as u32, y as u32))
        };
        known.places().par_iter().with_min_len(256).filter_map(seen_at).collect()
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

/// A pass of a film with what was prepared for it.
fn step_on(
    technique: &mut dyn Technique,
    (world, view): (&World, &View),
    film: &mut Film,
    products: &mut Products,
    cancel: &AtomicBool,
) -> Progress {
    technique.step(&mut Step { world, products, canvas: Some(Canvas { view, film }), cancel })
}

/// Settings of a path tracer of all that is to be seen.
fn all_paths(settings: &RenderSettings) -> PathSettings {
    let shown = settings.effects.shown();
    let all = PathSettings::all(settings.bounces_max, settings.seed);
    PathSettings { shown, traced: shown, knows_openings: true, ..all }
}

/// The same for the film beside one of looked-up light, with numbers of its own: its samples are independent of the other's.
fn beside(settings: &RenderSettings) -> PathSettings {
    let settings = all_paths(settings);
    PathSettings { seed: sobol::mix(settings.seed ^ 0x0070_6174_6800), ..settings }
}

/// The path tracer that draws with what is known; by itself where nothing is known yet and that is to be
/// [traced](RenderSettings::traces_unknown).
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
        Indirect::None => true,
        Indirect::Path => false,
        Indirect::Auto | Indirect::Octree | Indirect::Irradiance => {
            settings.looks_up() && (learnt.is_none() || !settings.traces_unknown())
        }
    };
    match known.filter(|_| learnt.is_some()) {
        Some(known) => PathTracer::with_secondary(PathSettings { shown: looked_up, ..path }, known),
        None if asks => PathTracer::new(PathSettings { shown: looked_up, ..path }.asking()),
        None => PathTracer::new(path),
    }
}
