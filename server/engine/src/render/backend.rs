//! Where a picture is drawn: on the CPU, or on a graphics card.
//!
//! What a card draws are samples of the picture, the same that the CPU would have drawn but for rounding. So a picture may be begun
//! on one and ended on the other, and where a card fails, the CPU goes on. A card also gathers the light of records of irradiance, for
//! pictures that learn by themselves. Other light is learnt and errors are measured on the CPU in either case.

use std::{
    sync::{Arc, atomic::AtomicBool},
    time::Instant,
};

use super::{
    Illumination, IlluminationSettings, Learnt, RenderSettings, Rendering, Stage, all_paths, beside,
    learner::tracer_of_records, learning::Begun, measuring::Measuring, step_on, tracer,
};
use crate::{
    effects::EffectPlan,
    film::{Display, Film, PictureSize},
    gpu::GpuError,
    scene::CameraView,
    technique::{
        ArrivingLight, Canvas, Counts, GatherRay, Products, Progress, SecondaryLight, Step, Technique, View,
        path::{
            ArrivingByGpu, Asked, GpuGatherer, GpuPathTracer, GpuPhotons, GpuScene, Shading, ShownAs,
            rays_over_a_picture,
        },
    },
    transport::{PathClasses, World},
};

/// Longest sides of the pictures by which backends are compared, px. Two, since a card takes its time to begin with anything and little
/// more for more: what it takes for a large picture is not told by a small one (on an H200 256 × 144 pixels of Sponza take longer than on
/// 16 threads, 1920 × 1080 a third).
const TRIAL_SIDES_MAX: [u32; 2] = [256, 512];
/// Least share of what a pixel of the larger one takes that each further one is taken to cost, as times are of chance.
const TRIAL_SLOPE_MIN: f64 = 0.1;
/// Passes of each; the fastest counts.
const TRIAL_PASSES: u32 = 2;
/// Rays that light is gathered along for each pixel of such a picture: as many in all as some hundred records send, so that a card
/// has enough to do.
const TRIAL_RAYS: u32 = 2;

/// Seconds that a pass of the picture takes on either backend, as smaller ones tell, and gathering light along rays where pictures have
/// records of their own.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BackendTrial {
    /// On the threads of the pool that it was asked in.
    pub cpu_seconds: f64,
    /// On the card; infinite where it did not end its passes.
    pub gpu_seconds: f64,
}

impl BackendTrial {
    /// Draws small pictures on both, with the first that is learnt of other light where that is looked up, and gathers for one where that
    /// has records.
    ///
    /// Errors: what the card does not do.
    pub fn run(
        scene: &Arc<GpuScene>,
        view: &CameraView,
        size: PictureSize,
        settings: &RenderSettings,
    ) -> Result<BackendTrial, GpuError> {
        let world = scene.world();
        let [small, larger] = TRIAL_SIDES_MAX.map(|side_max| shrunk(size, side_max));
        let learnt = settings.learns(&EffectPlan::of(world.scene()));
        let known = learnt.and_then(|_| first_known(world, settings));
        let mut cpu = tracer(settings, PathClasses::ALL, learnt, known.clone());
        let mut card = GpuPathTracer::new(Arc::clone(scene), all_paths(settings));
        card.draw_as(&cpu);
        let pass_seconds = |technique: &mut dyn Technique| {
            let of = |size| fastest_pass(technique, world, &View::new(world, view, size), size);
            seconds_for(size, [small, larger], [small, larger].map(of))
        };
        let [cpu_seconds, gpu_seconds] = [&mut cpu as &mut dyn Technique, &mut card].map(pass_seconds);
        let drawing = BackendTrial { cpu_seconds, gpu_seconds };
        if let Some(error) = card.failure() {
            return Err(error.clone());
        }
        if learnt != Some(Learnt::Records) {
            return Ok(drawing);
        }
        let rays = rays_over_a_picture(world, &View::new(world, view, small), small, TRIAL_RAYS);
        let gathering = BackendTrial::of_gathering(scene, &rays, settings, known)?;
        let as_often = size.pixel_count() as f64 / small.pixel_count() as f64;
        Ok(BackendTrial {
            cpu_seconds: drawing.cpu_seconds + as_often * gathering.cpu_seconds,
            gpu_seconds: drawing.gpu_seconds + as_often * gathering.gpu_seconds,
        })
    }

    fn of_gathering(
        scene: &Arc<GpuScene>,
        rays: &[GatherRay],
        settings: &RenderSettings,
        known: Option<Arc<dyn SecondaryLight>>,
    ) -> Result<BackendTrial, GpuError> {
        let world = scene.world();
        let gatherer = Arc::new(GpuGatherer::new(Arc::clone(scene)));
        let card = ArrivingByGpu::new(tracer_of_records(settings, known).0, Arc::clone(&gatherer));
        let gpu_seconds = fastest(|| gather(&card, world, rays));
        if let Some(error) = gatherer.failure() {
            return Err(error);
        }
        // From now on the CPU answers, in the same batches.
        gatherer.stop();
        Ok(BackendTrial { cpu_seconds: fastest(|| gather(&card, world, rays)), gpu_seconds })
    }

    /// The card is.
    pub fn gpu_is_faster(&self) -> bool {
        self.gpu_seconds < self.cpu_seconds
    }
}

/// The first that is learnt of a scene's light; thrown away with the trial.
fn first_known(world: &World, settings: &RenderSettings) -> Option<Arc<dyn SecondaryLight>> {
    let mut illumination = Illumination::new(IlluminationSettings::of(settings));
    while illumination.known().is_none() && illumination.stage() != Stage::Complete {
        illumination.step(world, &AtomicBool::new(false));
    }
    illumination.known().cloned()
}

/// A picture of that form whose longest side is no longer.
fn shrunk(size: PictureSize, side_max: u32) -> PictureSize {
    let shrink = f64::from(size.width().max(size.height())) / f64::from(side_max);
    let side = |length: u32| ((f64::from(length) / shrink.max(1.0)) as u32).max(1);
    PictureSize::new(side(size.width()), side(size.height())).unwrap_or(size)
}

/// What a pass of a size takes, where passes of a smaller size and of one in between took so long.
fn seconds_for(size: PictureSize, tried: [PictureSize; 2], [small, larger]: [f64; 2]) -> f64 {
    // One that did not end its passes.
    if !larger.is_finite() {
        return f64::INFINITY;
    }
    let [of_small, of_larger, all] = [tried[0], tried[1], size].map(|size| size.pixel_count() as f64);
    let each = larger / of_larger;
    let slope = (larger - small) / (of_larger - of_small).max(1.0);
    larger + slope.clamp(TRIAL_SLOPE_MIN * each, each) * (all - of_larger)
}

fn fastest_pass(technique: &mut dyn Technique, world: &World, view: &View, size: PictureSize) -> f64 {
    let mut film = Film::new(size);
    let cancel = AtomicBool::new(false);
    let seconds = fastest(|| {
        let (canvas, products) = (Some(Canvas { view, film: &mut film }), &mut Products::default());
        technique.step(&mut Step { world, products, canvas, cancel: &cancel });
    });
    // A pass that a lost device cut short is no fast one.
    if film.passes_min() == TRIAL_PASSES { seconds } else { f64::INFINITY }
}

fn gather(arriving: &dyn ArrivingLight, world: &World, rays: &[GatherRay]) {
    arriving.along(world, rays, &AtomicBool::new(false), &mut Counts::default());
}

fn fastest(mut work: impl FnMut()) -> f64 {
    let seconds = |_| {
        let start = Instant::now();
        work();
        start.elapsed().as_secs_f64()
    };
    (0..TRIAL_PASSES).map(seconds).fold(f64::INFINITY, f64::min)
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
    /// Where it learns of its light by itself.
    learning: Option<LearningOnCard>,
    /// For the path-traced film beside it.
    tracing: Option<GpuPathTracer>,
    /// How the card is to show the first pass, and that as it did, with how.
    shown_as: Option<Arc<Display>>,
    shown: Option<(Arc<Display>, Vec<u8>)>,
    /// What the CPU traced beside, and the seconds that took.
    cpu_rays: u64,
    cpu_seconds: f64,
}

/// What carries photons and gathers the light of records.
#[derive(Debug)]
struct LearningOnCard {
    photons: Arc<GpuPhotons>,
    gatherer: Arc<GpuGatherer>,
    /// Of them that were taken note of.
    noted_photons: u64,
    noted_rays: u64,
}

impl LearningOnCard {
    /// Why nothing more is to be done on the card. Photons that have no room there are the CPU's, and all else goes on.
    fn failure(&self) -> Option<GpuError> {
        let is_fatal = |error: &GpuError| !matches!(error, GpuError::OutOfMemory { .. });
        self.photons.failure().filter(is_fatal).or_else(|| self.gatherer.failure())
    }

    fn stop(&self) {
        self.photons.stop();
        self.gatherer.stop();
    }
}

impl OnGpu {
    /// Rays that the CPU would have traced in so many seconds.
    fn rays_in(&self, seconds: f64) -> u64 {
        let is_known = self.cpu_seconds > RATE_KNOWN_SECONDS;
        let rate = if is_known { self.cpu_rays as f64 / self.cpu_seconds } else { CPU_RAYS_PER_SECOND };
        (rate * seconds) as u64
    }

    /// Work that is not done in rays says nothing of the CPU's rate.
    fn note_cpu_work(&mut self, rays: u64, seconds: f64) {
        if rays > 0 {
            self.cpu_rays += rays;
            self.cpu_seconds += seconds;
        }
    }

    /// Seconds of compiling shaders for its scene.
    pub(super) fn shader_seconds(&self) -> f64 {
        self.scene.shader_seconds()
    }

    fn failure(&self) -> Option<GpuError> {
        let of_learning = || self.learning.as_ref()?.failure();
        let of_tracing = || self.tracing.as_ref()?.failure().cloned();
        self.drawing.failure().cloned().or_else(of_learning).or_else(of_tracing)
    }
}

impl RenderSettings {
    /// Uploads all and compiles what such pictures of a scene need that learn by themselves, so that none waits for it.
    ///
    /// Errors: what the card does not do.
    pub fn make_ready(&self, scene: &GpuScene) -> Result<(), GpuError> {
        let plan = EffectPlan::of(scene.world().scene());
        let learnt = self.learns(&plan);
        let asked = learnt.map(|learnt| match learnt {
            Learnt::Octree => Asked::Octree,
            Learnt::Records => Asked::Records,
        });
        let is_hidden = self.brings_hidden(&plan);
        scene.make_ready(Shading { asked, is_focused: self.focuses(&plan) || is_hidden })?;
        if self.traces_unknown() {
            // Path tracing, before anything is known, and by the best there is beside that.
            scene.make_ready(Shading { asked: None, is_focused: is_hidden })?;
        }
        if learnt.is_some() {
            scene.make_ready_for_photons()?;
        }
        if learnt == Some(Learnt::Records) {
            // With a bound on scatterings nobody is asked: see `Learner`.
            scene.make_ready_to_gather(self.bounces_max.is_none())?;
        }
        Ok(())
    }
}

impl Rendering {
    /// Draws on a card from now on.
    ///
    /// - `scene`: of the same world
    pub fn draw_on(&mut self, scene: Arc<GpuScene>) {
        let drawing = GpuPathTracer::new(Arc::clone(&scene), all_paths(&self.settings));
        let on_gpu = OnGpu {
            drawing,
            learning: None,
            scene,
            tracing: None,
            shown_as: None,
            shown: None,
            cpu_rays: 0,
            cpu_seconds: 0.0,
        };
        self.gpu = Some(Box::new(on_gpu));
        self.measuring.iter_mut().for_each(Measuring::go_without_openings);
        self.gpu_failure = None;
    }

    /// Draws on a card, and if the picture learns of its light by itself, carries its photons and gathers the light of its records
    /// there as well. Call it before the first [`Rendering::step`]; whoever draws for others at the same time does not want to wait
    /// for that.
    ///
    /// - `scene`: of the same world
    pub fn draw_and_learn_on(&mut self, scene: Arc<GpuScene>) {
        self.draw_and_gather_on(scene);
        let learning = self.gpu.as_ref().and_then(|gpu| gpu.learning.as_ref());
        if let (Some(learner), Some(learning)) = (&mut self.learner, learning) {
            learner.carry_by(Arc::clone(&learning.photons) as _);
        }
    }

    /// The same, with photons of the CPU.
    pub(crate) fn draw_and_gather_on(&mut self, scene: Arc<GpuScene>) {
        self.draw_on(Arc::clone(&scene));
        let (Some(learner), Some(gpu)) = (&mut self.learner, &mut self.gpu) else { return };
        let photons = Arc::new(GpuPhotons::new(Arc::clone(&scene)));
        let gatherer = Arc::new(GpuGatherer::new(scene));
        if self.learnt == Some(Learnt::Records) {
            learner.gather_on(Arc::clone(&gatherer));
        }
        gpu.learning = Some(LearningOnCard { photons, gatherer, noted_photons: 0, noted_rays: 0 });
    }

    /// Light is looked up for it, which a card must have room for.
    pub fn looks_light_up(&self) -> bool {
        self.learnt.is_some() || self.caustics.is_some() || self.hidden.iter().any(Option::is_some)
    }

    /// Goes on by the CPU.
    pub fn leave_gpu(&mut self) {
        if let Some(learning) = self.gpu.take().and_then(|gpu| gpu.learning) {
            learning.stop();
        }
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

    /// Rays along which a card gathered light for records.
    pub fn gpu_gathered_rays(&self) -> u64 {
        self.gpu_gathered_rays
    }

    /// Photons that a card carried.
    pub fn gpu_carried_photons(&self) -> u64 {
        self.gpu_carried_photons
    }

    /// Passes, rays and photons of a card: nothing where it did nothing.
    pub fn gpu_work(&self) -> u64 {
        self.gpu_passes + self.gpu_gathered_rays + self.gpu_carried_photons
    }

    /// The scene on the card that it is drawn on.
    pub fn gpu_scene(&self) -> Option<&Arc<GpuScene>> {
        self.gpu.as_ref().map(|gpu| &gpu.scene)
    }

    /// This was done for learning since then; takes note of failures.
    pub(super) fn note_learning(&mut self, rays: u64, begun: &Begun) {
        let Some(gpu) = self.gpu.as_mut() else { return };
        let seconds =
            begun.start.elapsed().as_secs_f64() - (gpu.scene.shader_seconds() - begun.shader_seconds);
        if let Some(learning) = &mut gpu.learning {
            let (carried, gathered) = (learning.photons.photon_count(), learning.gatherer.ray_count());
            let is_by_card = carried > learning.noted_photons || gathered > learning.noted_rays;
            self.gpu_carried_photons += carried - learning.noted_photons;
            self.gpu_gathered_rays += gathered - learning.noted_rays;
            (learning.noted_photons, learning.noted_rays) = (carried, gathered);
            if is_by_card || learning.failure().is_some() {
                self.count_gpu_work(rays, seconds);
                return;
            }
        }
        gpu.note_cpu_work(rays, seconds);
    }

    /// The CPU did this beside a card.
    pub(super) fn note_cpu_work(&mut self, rays: u64, start: Instant) {
        if let Some(gpu) = &mut self.gpu {
            gpu.note_cpu_work(rays, start.elapsed().as_secs_f64());
        }
    }

    /// Lets the card that draws it show its first pass by itself, which takes it far less time than showing the film takes the CPU. Nothing
    /// else changes; where no card draws it nothing does.
    pub fn show_first_as(&mut self, display: &Arc<Display>) {
        if let Some(gpu) = &mut self.gpu {
            gpu.shown_as = Some(Arc::clone(display));
        }
    }

    /// What its card has shown of it, as long as it has no more than that pass: sRGB bytes of what [`Rendering::picture`] shows, rows top to
    /// bottom, but for codes that rounding decides; and as what.
    pub fn shown_by_card(&self) -> Option<(&Arc<Display>, &[u8])> {
        let is_of_first = self.lit_passes() == [1, 1] && self.traced.is_none();
        let gpu = self.gpu.as_ref().filter(|_| is_of_first)?;
        gpu.shown.as_ref().map(|(shown_as, bytes)| (shown_as, &bytes[..]))
    }

    /// A pass on the card; `None` where the CPU draws it, and after a failure.
    ///
    /// - `products`: focused light of the pass
    pub(super) fn draw_on_gpu(&mut self, products: &mut Products, cancel: &AtomicBool) -> Option<Progress> {
        let denoises = self.denoises().is_some();
        let gpu = self.gpu.as_mut()?;
        let drawing = &mut gpu.drawing;
        drawing.draw_as(&self.technique);
        drawing.show_first_as(gpu.shown_as.clone().map(|display| ShownAs { display, denoises }));
        let (start, shaders) = (Instant::now(), gpu.scene.shader_seconds());
        let progress = step_on(drawing, (&self.world, &self.view), &mut self.film, products, cancel);
        gpu.shown = gpu.shown_as.clone().zip(drawing.take_shown());
        let seconds = start.elapsed().as_secs_f64() - (gpu.scene.shader_seconds() - shaders);
        let rays = self.count_pass(&progress, seconds);
        self.looked_up_rays += rays;
        Some(progress)
    }

    /// A pass of the path-traced film on the card; as [`Rendering::draw_on_gpu`].
    pub(super) fn trace_on_gpu(&mut self, products: &mut Products, cancel: &AtomicBool) -> Option<Progress> {
        let gpu = self.gpu.as_mut()?;
        let (size, settings) = (self.film.size(), beside(&self.settings));
        let film = self.traced.get_or_insert_with(|| Film::unfiltered(size));
        let scene = &gpu.scene;
        let tracing = gpu.tracing.get_or_insert_with(|| GpuPathTracer::new(Arc::clone(scene), settings));
        let (start, shaders) = (Instant::now(), gpu.scene.shader_seconds());
        let progress = step_on(tracing, (&self.world, &self.view), film, products, cancel);
        let seconds = start.elapsed().as_secs_f64() - (gpu.scene.shader_seconds() - shaders);
        let rays = self.count_pass(&progress, seconds);
        self.traced_rays += rays;
        Some(progress)
    }

    /// Does what is work on the card but no pass.
    pub(super) fn counted_as_card_work<T>(&mut self, work: impl FnOnce() -> T) -> T {
        let compiled = |rendering: &Rendering| rendering.gpu.as_ref().map_or(0.0, |gpu| gpu.shader_seconds());
        let (start, shaders) = (Instant::now(), compiled(self));
        let done = work();
        let seconds = start.elapsed().as_secs_f64() - (compiled(self) - shaders);
        self.looked_up_rays += self.count_gpu_work(0, seconds);
        done
    }

    fn count_pass(&mut self, progress: &Progress, seconds: f64) -> u64 {
        self.gpu_passes += u64::from(progress.complete);
        self.count_gpu_work(progress.counts.all_rays(), seconds)
    }

    /// What work on the card counts for, in rays of the CPU; takes note of failures.
    fn count_gpu_work(&mut self, rays_on_card: u64, seconds: f64) -> u64 {
        let Some(gpu) = &self.gpu else { return 0 };
        let rays = gpu.rays_in(seconds);
        self.surplus_rays += rays as i64 - rays_on_card as i64;
        if let Some(error) = gpu.failure() {
            self.give_gpu_up(error);
        }
        rays
    }

    /// Goes on by the CPU, and says why.
    pub(super) fn give_gpu_up(&mut self, error: GpuError) {
        self.gpu_failure = Some(error);
        self.leave_gpu();
    }

    /// It is drawn on a card that has not refused a sketch of caustics.
    pub(super) fn sketches_on_gpu(&self) -> bool {
        self.gpu.as_ref().is_some_and(|gpu| !gpu.drawing.refuses_sketches())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What takes as long for every pixel is told by any two sizes, with what it takes to begin; chance neither makes pixels free nor dearer
    /// than those that were drawn.
    #[test]
    fn small_passes_tell_what_large_ones_take() {
        let size = |width| PictureSize::new(width, 100).unwrap();
        let (tried, whole) = ([size(10), size(40)], size(1000));
        let near = |of: [f64; 2], expected: f64| {
            let seconds = seconds_for(whole, tried, of);
            assert!((seconds - expected).abs() < 1e-9, "{of:?}: {seconds} for {expected}");
        };
        near([0.001 * 1000.0, 0.001 * 4000.0], 0.001 * 100_000.0);
        near([3.0 + 0.001 * 1000.0, 3.0 + 0.001 * 4000.0], 3.0 + 0.001 * 100_000.0);
        // Faster with more pixels: a tenth of what one took.
        near([8.0, 4.0], 4.0 + 0.0001 * 96_000.0);
        // As if pixels became dearer.
        near([0.1, 4.0], 0.001 * 100_000.0);
        assert_eq!(seconds_for(whole, tried, [1.0, f64::INFINITY]), f64::INFINITY);
        assert_eq!(seconds_for(size(40), tried, [1.0, 2.0]), 2.0);
        assert_eq!(seconds_for(size(10), [size(10); 2], [1.0, 1.5]), 1.5);
        assert_eq!(shrunk(PictureSize::new(1920, 1080).unwrap(), 256), PictureSize::new(256, 144).unwrap());
        assert_eq!(shrunk(size(40), 256), size(40));
    }
}
