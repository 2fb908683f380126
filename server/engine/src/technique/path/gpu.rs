//! The path tracer on a graphics card: a slice of the picture at a time, one scattering of all its paths after the other.
//!
//! Twin of `cpu.rs`: it draws the same numbers for the same pixel and pass and takes the same decisions, so that both
//! backends add to one film. What differs is rounding (a card may fuse and reorder), which moves a few paths in ten thousand
//! to another side of a decision.
//!
//! The same paths begin with rays that light is gathered along (`gather.rs`), and photons go through like steps (`photons.rs`).
//! Steps (`shaders/path`), for a slice:
//! `begin`; then as long as paths go on `closest`, `shade`, `turn`, `occluded`. Paths keep their place, one a pixel;
//! queues hold the places of those that go on, so that later scatterings cost by what is left of them. How many are
//! left is read now and then only: steps take their size from a buffer that `turn` writes.
//!
//! The last paths of a slice go on by the CPU (`handed.rs`), which follows them while the card traces the next.
//! First passes are shown by the card itself where somebody asks for that (`first_shown.rs`); maps may tell their shadows then, in two steps between
//! `turn` and `occluded` (`shadow_maps.rs`). What of the scene lies on the card (`world.rs`) follows edits (`followed.rs`).
//!
//! **Watchdogs** end whatever keeps a card busy for long. A slice is as large as its first batch of commands takes
//! [`BATCH_SECONDS`], and is halved and doubled as that changes.

mod first_shown;
mod followed;
mod gather;
mod handed;
mod known;
mod lookouts;
mod photons;
mod sample;
mod scene;
mod shadow_maps;
mod sketch;
mod slices;
mod splats;
mod step_clock;
#[cfg(test)]
mod tests;
mod tracing;
mod world;

use std::sync::{
    Arc,
    atomic::{AtomicBool, Ordering},
};

use bytemuck::{Pod, Zeroable};
use rayon::prelude::*;

pub use first_shown::ShownAs;
pub use gather::{ArrivingByGpu, GpuGatherer, rays_over_a_picture};
pub use known::{Asked, Shading};
pub use photons::GpuPhotons;
pub use scene::GpuScene;
pub use shadow_maps::{MapsCompared, Shadows};
pub use splats::{SplatBy, SplatSeconds, Splatted};
pub use step_clock::StepSeconds;

use self::{
    handed::{Followed, GpuHandedPath},
    known::{LightBeside, undimmed},
    sample::{GpuPixelSample, copy_samples},
    tracing::{PathStart, SAMPLE_BYTES, Tracing},
};
use super::{
    CARD, PathSettings, PathTracer, View,
    cpu::{BOUNCES_END, Near, Tracer, primary_ray},
};
use crate::{
    film::{Film, Outdated},
    gpu::{FrameOnCard, GpuError, ReadBack},
    math::{Rgb, sobol::PixelSampler},
    technique::{
        Canvas, Card, Counts, Edit, FocusedLight, LeftToSampling, Progress, SecondaryLight, Step, Technique,
    },
    transport::PathClass,
};

/// Longest time that a batch of commands is to take: watchdogs bark after a second or two, and a cancelled picture waits for
/// the batch that runs.
const BATCH_SECONDS: f64 = 0.01;
/// The same where the adapter is the CPU itself: no watchdog there, and small batches cost as much to begin as to run.
const SOFTWARE_BATCH_SECONDS: f64 = 0.1;
/// Flags of `GpuPassHeader::focus`.
const IS_ASKING: u32 = 1;
const SHOWS_CAUSTICS: u32 = 2;
const LEAVES_SUNS: u32 = 4;
const LEAVES_SKY: u32 = 8;
/// Devices that may be lost one after the other without a finished pass before it is given up.
const LOSSES_MAX: u32 = 3;
/// Samples that a thread copies at a time: 384 KiB, which takes longer than finding a thread.
const SAMPLES_AT_ONCE: usize = 4096;

/// `PassHeader` in WGSL.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(super) struct GpuPassHeader {
    origin: [f32; 3],
    half_width: f32,
    right: [f32; 3],
    half_height: f32,
    up: [f32; 3],
    is_perspective: u32,
    back: [f32; 3],
    width: u32,
    seed_key: [u32; 2],
    sequence: u32,
    index: u32,
    height: u32,
    first_pixel: u32,
    path_count: u32,
    capacity: u32,
    traced: u32,
    bounces_end: u32,
    brought: u32,
    shadowed_from: u32,
    dimmed: [f32; 3],
    focus: u32,
}

/// `Counters` in WGSL.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(super) struct GpuCounters {
    parity: u32,
    ray_count: u32,
    next_ray_count: u32,
    shadow_count: u32,
    next_shadow_count: u32,
    rays: u32,
    shadow_rays: u32,
    kept: u32,
    shadows_at: u32,
    next_left_count: u32,
    pane_rays: u32,
}

/// `GpuPassHeader::focus`.
///
/// - `focused`: what is known of such light
fn focus_of(settings: &PathSettings, focused: Option<&dyn FocusedLight>) -> u32 {
    let asking = if settings.asks { IS_ASKING } else { 0 };
    let shown = if settings.shown.contains(PathClass::Caustic) { SHOWS_CAUSTICS } else { 0 };
    let left = match settings.left_to_sampling(focused) {
        LeftToSampling::Nothing => 0,
        LeftToSampling::Suns => LEAVES_SUNS,
        LeftToSampling::SunsAndSky => LEAVES_SUNS | LEAVES_SKY,
    };
    asking | shown | left
}

/// A pass that was begun.
#[derive(Debug)]
struct Begun {
    header: GpuPassHeader,
    pass: u32,
    focused: Option<Arc<dyn FocusedLight>>,
    /// Who is to tell its shadows, and whether maps told any.
    shadows: Shadows,
    has_asked_maps: bool,
    /// Pixels, in rows, whose samples are here. Those of the last slice may lack what paths bring that were handed over.
    taken: usize,
}

/// A pass that is traced.
#[derive(Debug)]
struct Running {
    begun: Begun,
    coming: Option<Coming>,
    /// Of samples that were taken and are not whole yet.
    handed: Option<Handed>,
    /// Of what was traced here.
    counts: Counts,
}

impl Running {
    fn new(begun: Begun) -> Running {
        Running { begun, coming: None, handed: None, counts: Counts::default() }
    }
}

impl Running {
    /// Pixels, in rows, whose paths were traced.
    fn traced(&self) -> usize {
        self.begun.taken + self.coming.as_ref().map_or(0, |coming| coming.count)
    }
}

/// Samples on their way from the card, after those that are here.
#[derive(Debug)]
struct Coming {
    count: usize,
    brought: ReadBack,
    handed: Vec<GpuHandedPath>,
}

/// Paths of a slice that the CPU is to follow.
#[derive(Debug)]
struct Handed {
    first_pixel: usize,
    paths: Vec<GpuHandedPath>,
}

/// Path tracing on a graphics card, by itself or asking a [`SecondaryLight`] and a [`FocusedLight`] that are packed for it.
///
/// After an error it draws nothing more and says why: [`GpuPathTracer::failure`]. The film is then as valid as before, and the
/// CPU goes on with the same samples.
#[derive(Debug)]
pub struct GpuPathTracer {
    scene: Arc<GpuScene>,
    settings: PathSettings,
    secondary: Option<Arc<dyn SecondaryLight>>,
    begun: Option<Begun>,
    /// Of the pass that was begun, by pixel in rows, as far as they were taken. Kept from pass to pass: fresh memory costs more than
    /// what is written to it.
    samples: Vec<GpuPixelSample>,
    /// Paths of the next slice.
    slice: u32,
    /// How the card is to show first passes, what it showed of the last pass, and pixels of that which the CPU had to complete.
    shown_as: Option<ShownAs>,
    /// Who tells shadows of those, where maps are to be had.
    first_shadows: Shadows,
    shown: Option<Vec<u8>>,
    completed: Vec<usize>,
    /// A sketch of caustics had no room beside what it drew with.
    refuses_sketches: bool,
    failure: Option<GpuError>,
}

impl GpuPathTracer {
    /// Memory of a picture from its first pass on, beside the card's.
    pub const BYTES_PER_PIXEL: usize = SAMPLE_BYTES as usize;

    /// Pictures of a scene; steps are to be of the same world.
    pub fn new(scene: Arc<GpuScene>, settings: PathSettings) -> GpuPathTracer {
        let slice = scene.pixels_at_once.load(Ordering::Relaxed);
        GpuPathTracer {
            first_shadows: scene.first_shadows(),
            scene,
            settings,
            secondary: None,
            begun: None,
            samples: Vec::new(),
            slice,
            shown_as: None,
            shown: None,
            completed: Vec::new(),
            refuses_sketches: false,
            failure: None,
        }
    }

    /// Draws what `tracer` would from now on.
    pub fn draw_as(&mut self, tracer: &PathTracer) {
        let is_same = known::is_same(self.secondary.as_ref(), tracer.secondary.as_ref());
        if self.settings != tracer.settings || !is_same {
            self.settings = tracer.settings;
            self.secondary.clone_from(&tracer.secondary);
            self.begun = None;
        }
    }

    /// Why it draws nothing more.
    pub fn failure(&self) -> Option<&GpuError> {
        self.failure.as_ref()
    }

    /// A sketch of caustics had no room: the CPU is to draw the pass that shows it, of which nothing is kept here. That is no failure.
    pub fn refuses_sketches(&self) -> bool {
        self.refuses_sketches
    }

    /// The scene that it draws.
    pub fn scene(&self) -> &Arc<GpuScene> {
        &self.scene
    }

    /// Traces the next slice of a pass; its samples are coming then.
    ///
    /// Those of the slice before are taken first, so that a pass never needs room for those of two slices on their way. Their last paths
    /// are followed meanwhile, by other threads than the one that holds the card: those may wait for it.
    ///
    /// - `frame`: gets the samples as well
    fn trace_slice(
        &mut self,
        running: &mut Running,
        pixel_count: usize,
        frame: Option<&FrameOnCard>,
    ) -> Result<(), GpuError> {
        self.take_coming(running)?;
        let handed = running.handed.take();
        let first_pixel = running.traced() as u32;
        let wanted = self.slice.min(pixel_count as u32 - first_pixel);
        let Running { begun, coming, counts, .. } = running;
        let Begun { header, focused, shadows, has_asked_maps, .. } = begun;
        let (known, _) = undimmed(self.secondary.as_ref());
        let light = LightBeside { known, focused: focused.as_ref(), shadows: *shadows };
        // What a card has counted of a sketch the CPU would have to count as well.
        let hands_over = focused.as_ref().is_none_or(|focused| !focused.is_sketch());
        let mut followed = Vec::new();
        let trace = |tracing: Tracing<'_>| {
            let capacity = tracing.capacity();
            let path_count = wanted.min(capacity);
            let header = GpuPassHeader { first_pixel, path_count, capacity, ..*header };
            let mut slice = tracing.trace_all(&header, hands_over)?;
            let handed = std::mem::take(&mut slice.handed);
            if let Some(frame) = frame {
                tracing.copy_samples(frame.samples(), first_pixel, path_count)?;
            }
            let brought = tracing.bring(&slice)?;
            let coming = Coming { count: path_count as usize, brought, handed };
            Ok((slice, coming, tracing.maps.is_some()))
        };
        let traced = rayon::scope(|scope| {
            if let Some(handed) = &handed {
                scope.spawn(|_| followed = self.follow(handed, header.index, focused.as_deref()));
            }
            self.scene.trace_with(PathStart::Pixels, pixel_count, light, trace)
        });
        *counts += handed.map_or_else(Counts::default, |handed| self.add_followed(&handed, &followed));
        let (slice, next, asks_maps) = traced?;
        *coming = Some(next);
        *has_asked_maps |= asks_maps;
        *counts += slice.counts;
        self.slice = self.scene.slice_after(PathStart::Pixels, self.slice, wanted, slice.first_seconds);
        self.scene.pixels_at_once.store(self.slice, Ordering::Relaxed);
        Ok(())
    }

    /// Takes the samples that are coming, by all threads: nothing of the card is held here.
    fn take_coming(&mut self, running: &mut Running) -> Result<(), GpuError> {
        let Some(Coming { count, brought, handed }) = running.coming.take() else { return Ok(()) };
        let first_pixel = running.begun.taken;
        let room = self.samples[first_pixel..][..count].par_chunks_mut(SAMPLES_AT_ONCE);
        self.scene.take(brought, |bytes| {
            let parts = bytes.par_chunks(SAMPLES_AT_ONCE * SAMPLE_BYTES as usize);
            room.zip(parts).for_each(|(room, bytes)| copy_samples(bytes, room));
        })?;
        running.begun.taken += count;
        running.handed = (!handed.is_empty()).then_some(Handed { first_pixel, paths: handed });
        Ok(())
    }

    /// What paths bring that a card has handed over.
    fn follow(&self, handed: &Handed, index: u32, focused: Option<&dyn FocusedLight>) -> Vec<Followed> {
        let tracer = Tracer {
            secondary: self.secondary.as_deref(),
            caustics: focused,
            near: Near::Shadowed,
            // As cards sample.
            ..Tracer::of(self.scene.world(), PathSettings { knows_openings: false, ..self.settings })
        };
        handed::follow(&tracer, &handed.paths, |_| Some(index))
    }

    /// Adds that to the samples, and says what it took.
    fn add_followed(&mut self, handed: &Handed, followed: &[Followed]) -> Counts {
        let samples = &mut self.samples[handed.first_pixel..];
        for Followed { slot, sample: more, .. } in followed {
            if let Some(sample) = samples.get_mut(*slot) {
                sample.add(more);
                self.completed.push(handed.first_pixel + slot);
            }
        }
        followed.iter().map(|followed| followed.counts).sum()
    }

    /// Slices until a pass is whole or is not wanted any more. Their samples are here then; after an error some of them are.
    fn trace_slices(
        &mut self,
        running: &mut Running,
        pixel_count: usize,
        frame: Option<&FrameOnCard>,
        cancel: &AtomicBool,
    ) -> Result<Progress, GpuError> {
        let mut complete = true;
        while running.traced() < pixel_count && complete {
            if cancel.load(Ordering::Relaxed) {
                complete = false;
            } else {
                self.trace_slice(running, pixel_count, frame)?;
            }
        }
        self.take_rest(running)?;
        Ok(Progress { complete, counts: std::mem::take(&mut running.counts) })
    }

    /// Takes what the last slice brings, whole.
    fn take_rest(&mut self, running: &mut Running) -> Result<(), GpuError> {
        self.take_coming(running)?;
        if let Some(handed) = running.handed.take() {
            let Begun { header, focused, .. } = &running.begun;
            let followed = self.follow(&handed, header.index, focused.as_deref());
            running.counts += self.add_followed(&handed, &followed);
        }
        Ok(())
    }

    /// The whole pass, or as far as it came.
    fn trace_pass(&mut self, step: &mut Step<'_>) -> Result<Progress, GpuError> {
        let Some(Canvas { view, film }) = &mut step.canvas else {
            return Ok(Progress { complete: true, ..Progress::default() });
        };
        let pass = film.passes_min();
        let pixel_count = film.size().pixel_count();
        let focused = &step.products.caustics;
        let header = self.header_of(view, film, pass, focused.as_deref());
        let of_this = |begun: &Begun| {
            let is_same = known::is_same(begun.focused.as_ref(), focused.as_ref());
            begun.header == header && begun.pass == pass && is_same
        };
        let mut begun = match self.begun.take().filter(of_this) {
            Some(begun) => begun,
            None => {
                self.make_room(pixel_count)?;
                Begun {
                    header,
                    pass,
                    focused: focused.clone(),
                    shadows: Shadows::ByRays,
                    has_asked_maps: false,
                    taken: 0,
                }
            }
        };
        (self.shown, self.completed) = (None, Vec::new());
        let scene = Arc::clone(&self.scene);
        let mut frame = self.frame_of(&scene, film, &begun);
        // Path tracing is to be right from its first sample on.
        if frame.is_some() && self.secondary.is_some() && self.first_shadows == Shadows::ByMaps {
            begun.shadows = scene.shadows_of_first();
        }
        let mut running = Running::new(begun);
        let traced = loop {
            let shows = frame.as_ref().and_then(|frame| frame.as_ref());
            let traced = self.trace_slices(&mut running, pixel_count, shows, step.cancel);
            let is_too_much =
                matches!(traced, Err(GpuError::OutOfMemory { .. } | GpuError::LightTooLarge { .. }));
            if !is_too_much || frame.take().is_none() {
                break traced;
            }
            // Better drawn there and shown here than neither: its memory goes with the next slice that needs it.
            scene.frames_refused_from.fetch_min(pixel_count, Ordering::Relaxed);
        };
        let frame = frame.as_ref().and_then(|frame| frame.as_ref());
        if running.begun.taken < pixel_count {
            // Cancelled, or the device was lost: samples that are here stay.
            self.begun = Some(running.begun);
            return traced;
        }
        // The card shows it while the film takes it.
        let shown = frame.and_then(|frame| self.show(frame, film.size()));
        self.add_to(film);
        if running.begun.has_asked_maps {
            film.outdate(&[PathClass::Direct, PathClass::Caustic, PathClass::Indirect], Outdated::Wrong);
        }
        if !self.keep_shown(shown, film.size()) {
            self.scene.losses.store(0, Ordering::Relaxed);
        }
        traced
    }

    /// Has room for the samples of a pass.
    fn make_room(&mut self, pixel_count: usize) -> Result<(), GpuError> {
        if self.samples.len() == pixel_count {
            return Ok(());
        }
        // Not both at once.
        self.samples = Vec::new();
        let refused = |()| GpuError::OutOfMemory {
            name: "samples of a pass".into(),
            byte_count: pixel_count as u64 * SAMPLE_BYTES,
            bytes_allowed: 0,
            limit: "this machine's memory",
        };
        self.samples = bytemuck::allocation::try_zeroed_vec(pixel_count).map_err(refused)?;
        Ok(())
    }

    fn header_of(
        &self,
        view: &View,
        film: &Film,
        pass: u32,
        focused: Option<&dyn FocusedLight>,
    ) -> GpuPassHeader {
        let seed_key = PixelSampler::seed_key(self.settings.seed);
        let (_, dimmed) = undimmed(self.secondary.as_ref());
        GpuPassHeader {
            origin: view.origin.into(),
            half_width: view.half_size[0],
            right: view.right.into(),
            half_height: view.half_size[1],
            up: view.up.into(),
            is_perspective: u32::from(view.is_perspective),
            back: view.back.into(),
            width: film.size().width(),
            seed_key: [seed_key as u32, (seed_key >> 32) as u32],
            // As on the CPU: even and odd passes draw from sequences of their own.
            sequence: pass & 1,
            index: pass >> 1,
            height: film.size().height(),
            traced: self.settings.traced.bits(),
            bounces_end: self.settings.bounces_max.unwrap_or(BOUNCES_END),
            shadowed_from: self.settings.shadowed_from(),
            dimmed: dimmed.to_array(),
            focus: focus_of(&self.settings, focused),
            ..GpuPassHeader::zeroed()
        }
    }

    fn add_to(&self, film: &mut Film) {
        let width = film.size().width() as usize;
        let [least, most] = [film.passes_min(), film.passes_max()];
        let shown = self.settings.shown;
        film.tiles_mut().par_iter_mut().filter(|tile| least == most || tile.passes() < most).for_each(
            |tile| {
                tile.add_pass(|x, y| {
                    let mut sample = self.samples[y as usize * width + x as usize].unpacked();
                    for class in PathClass::ALL.into_iter().filter(|class| !shown.contains(*class)) {
                        sample.radiance[class as usize] = Rgb::BLACK;
                    }
                    sample
                });
            },
        );
    }
}

impl Technique for GpuPathTracer {
    fn card(&self) -> &'static Card {
        self.secondary.as_ref().map_or(&CARD, |secondary| secondary.card())
    }

    fn step(&mut self, step: &mut Step<'_>) -> Progress {
        if self.failure.is_some() {
            return Progress::default();
        }
        match self.trace_pass(step) {
            Ok(progress) => progress,
            // The next step opens another device and uploads again.
            Err(GpuError::Lost) if self.scene.losses.fetch_add(1, Ordering::Relaxed) < LOSSES_MAX => {
                Progress::default()
            }
            Err(GpuError::LightTooLarge { .. })
                if step.products.caustics.as_ref().is_some_and(|light| light.is_sketch()) =>
            {
                (self.refuses_sketches, self.begun) = (true, None);
                Progress::default()
            }
            Err(error) => {
                self.failure = Some(error);
                (self.begun, self.samples) = (None, Vec::new());
                Progress::default()
            }
        }
    }

    fn apply(&mut self, _edit: &Edit<'_>) {
        // Another world is another scene on the card.
        self.begun = None;
    }
}
