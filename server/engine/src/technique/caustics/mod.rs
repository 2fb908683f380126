//! Caustics: light that only mirrors and glass sent on before it falls on a diffuse surface (LS+DE), by photons of its own.
//!
//! Photons are aimed at what reflects or refracts, and nothing else (`targets.rs`, [`crate::transport::Aim`]), and followed
//! by specular lobes alone (`photons.rs`). Every pass over a picture gets a map of its own, with smaller blurs than the one
//! before; the mean over passes goes to the truth without any photon being kept [Hachisuka2008; Knaus2011] (`map.rs`). How
//! far a photon is blurred follows from how close photons lay in a first map: little in a focus, more where few fall
//! [Larsen2004, 12; Silverman1986, 5.3].
//!
//! First pictures after a camera has moved have them from fewer photons, counted on the screen (`screen/`).
//!
//! Photons carry as much flux each as if all lights had sent them out blindly: what this costs is in proportion to the share
//! of the light that falls on mirrors and glass, up to what there may be where nothing else lights what is seen (`worth.rs`). Where there
//! are none it costs nothing, where there are only rough coats, little.
//!
//! **Consistent**: blurs in every finite picture; what they lose at borders is made up for (`borders.rs`). It sees light of
//! point, spot and directional lights by way of mirrors and clear glass, which no path from the eye can find; and can be asked
//! for that alone. What comes straight through panes from infinitely far it leaves to light sampling ([`World::through_panes`]). What other light
//! of that kind shows in a gloss of less than [`crate::transport::Bsdf::has_broad_gloss`] nobody finds.

mod borders;
mod map;
mod photons;
mod pilot;
mod screen;
mod targets;
#[cfg(test)]
mod tests;
mod upload;
mod worth;

use std::{
    ops::Range,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Instant,
};

pub use map::{CausticMap, CausticPhoton};
pub use pilot::Sheet;
pub use screen::CausticSketch;

use self::{
    photons::{CausticTracer, Job, Traced},
    pilot::Pilot,
};
use super::{Bias, Card, Counts, Edit, FocusedLight, LeftToSampling, Progress, Step, Technique, View};
use crate::{
    math::sobol,
    transport::{Aim, PathClass, Source, World},
};

/// Which light is followed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum CausticLight {
    /// All of it.
    #[default]
    All,
    /// Light that no path from the eye can find: of lights without size, by a mirror or clear glass first, but for that of suns straight
    /// through panes.
    Hidden,
}

impl CausticLight {
    /// What of it photons leave to light sampling.
    fn left(self) -> LeftToSampling {
        match self {
            CausticLight::All => LeftToSampling::SunsAndSky,
            CausticLight::Hidden => LeftToSampling::Suns,
        }
    }
}

/// Parameters of caustics.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CausticSettings {
    /// Photons of a pass if all the light of the scene fell on mirrors and glass; as many fewer as less does, or as rough coats send on,
    /// but for those of a sketch.
    pub photons_per_pass: u32,
    /// Photons of a pass that flux alone asks for, at most; see [`CausticSettings::photons_end`].
    pub photons_max: u32,
    /// Most surfaces that a photon reaches; `None`: no bound.
    pub bounces_max: Option<u32>,
    /// Names the random numbers.
    pub seed: u64,
    /// Which light is followed.
    pub light: CausticLight,
    /// The picture that it is for: photons are spent on what shows there. `None`: any.
    pub seen_by: Option<View>,
    /// First passes whose photons go by flux all the same: those that are waited for.
    pub passes_by_flux: u32,
}

impl CausticSettings {
    /// For a picture of so many pixels.
    pub fn of(pixel_count: usize, bounces_max: Option<u32>, seed: u64) -> CausticSettings {
        let pixels = u32::try_from(pixel_count).unwrap_or(u32::MAX);
        CausticSettings {
            photons_per_pass: pixels.saturating_mul(PHOTONS_PER_PIXEL),
            photons_max: (pixels / PIXELS_PER_PHOTON).clamp(PHOTONS_LEAST, PHOTONS_END),
            bounces_max,
            seed,
            light: CausticLight::All,
            seen_by: None,
            passes_by_flux: 0,
        }
    }

    /// For first pictures by [`CausticSketch`].
    pub fn for_sketch(bounces_max: Option<u32>, seed: u64) -> CausticSettings {
        let (photons_per_pass, photons_max) = (u32::MAX, SKETCH_PHOTONS);
        CausticSettings {
            photons_per_pass,
            photons_max,
            bounces_max,
            seed,
            light: CausticLight::All,
            seen_by: None,
            passes_by_flux: 0,
        }
    }

    /// Photons of a pass at most: more than flux asks for where they are spent on what is seen (`worth.rs`).
    pub fn photons_end(&self) -> u32 {
        self.photons_max.saturating_mul(2).min(PHOTONS_END.max(self.photons_max))
    }

    /// Memory of a map with as many photons as there may be, where they show on a surface or two.
    pub fn bytes_max(&self) -> usize {
        self.photons_end() as usize * BYTES_PER_PHOTON
    }
}

/// Photons of a pass for every pixel, if all light fell on mirrors and glass.
const PHOTONS_PER_PIXEL: u32 = 2;
/// Pixels for every photon of a pass, at least: following photons takes less time than following the eye's paths. Half as many
/// make no difference to the error after twenty seconds, but blur more: a strip of wall between steps was 12 % too dark, and
/// is 2 %.
const PIXELS_PER_PHOTON: u32 = 2;
/// Photons of a pass at most in the smallest pictures, and in the largest. A photon takes some 120 bytes wherever it falls on a
/// surface that shows it: on one or two for most, on 17 in the mean where no light is lost at all (`photons.rs`).
const PHOTONS_LEAST: u32 = 1 << 12;
const PHOTONS_END: u32 = 1 << 18;
const BYTES_PER_PHOTON: usize = 256;
/// Photons of a sketch [Larsen2004, 14].
const SKETCH_PHOTONS: u32 = 10_000;
/// Photons that are followed before it is asked again whether that is still wanted.
const BATCH: u32 = 1 << 14;
/// Photons that are tried to find how much of all light falls on mirrors and glass, and of one light at least and at most.
const POINTS_OF_ALL: usize = 1 << 13;
const POINTS_OF_ONE: [usize; 2] = [8, 256];
/// A light of which no try met anything is taken to send so many tries' worth there: a lit texel may have been missed.
const MISSED: f64 = 0.25;

/// How fast blurs shrink: the area of pass i + 1 is (i + α) / (i + 1) of that of pass i; 1 would be not at all [Knaus2011].
const ALPHA: f64 = 0.6;
/// Photons that say how far others are to be blurred, at least.
const PILOT_PHOTONS: usize = 256;

static CARD: Card =
    Card { name: "caustics", classes: &[PathClass::Caustic, PathClass::Specular], bias: Bias::Consistent };

/// A map of caustics for every pass, on the CPU, on the rayon pool it is called in.
#[derive(Debug)]
pub struct Caustics {
    settings: CausticSettings,
    /// What photons start from; `None` before the first step.
    emission: Option<Emission>,
    /// Photons that say how far others are blurred, as long as they are few, and what they say.
    /// `None` once they are enough.
    collected: Option<Vec<CausticPhoton>>,
    pilot: Option<Arc<Pilot>>,
    /// The pass that is being made, or was made last.
    pass: Option<Pass>,
    /// Passes were made by flux alone, and those from now on show more.
    is_outdone: bool,
    report: CausticReport,
}

/// The photons of one pass.
#[derive(Debug)]
struct Pass {
    number: u32,
    /// What is left to be followed, last first.
    jobs: Vec<Job>,
    photons: Vec<CausticPhoton>,
    /// Once all were followed and their radii are known: of how many borders were made up for.
    corrected: Option<usize>,
    /// Once that is done.
    map: Option<Arc<CausticMap>>,
}

/// What photons start from.
#[derive(Debug)]
struct Emission {
    /// Radius of the smallest sphere that photons are aimed at, m.
    least_extent_m: f32,
    /// Lights that may reach something specular.
    lights: Vec<AimedLight>,
    /// They are weighed by what is seen.
    is_weighed: bool,
    /// That finding out took, until they are counted.
    rays: u64,
}

/// A light with the name of its numbers and the mean number of its photons in a pass.
#[derive(Debug)]
struct AimedLight {
    source: Source,
    /// What its photons are aimed at.
    aim: Aim,
    key: u64,
    photon_count: f64,
}

impl AimedLight {
    /// Numbers of its photons in the n-th of the passes that draw from one sequence: on average as many as there should be.
    fn numbers(&self, n: u32) -> Range<u64> {
        let [offset, ..] = sobol::point(self.key, 0);
        let first = |n: u32| (self.photon_count * f64::from(n) + f64::from(offset)) as u64;
        first(n)..first(n + 1)
    }
}

/// What it took and holds.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CausticReport {
    /// Seconds of following photons and of making maps.
    pub seconds: f64,
    /// Photons sent out in all passes.
    pub photons_emitted: u64,
    /// Of those, and of what they became, what fell on surfaces that show it.
    pub photons_stored: u64,
    /// Bytes of the newest map and of what says how far photons are blurred.
    pub bytes: usize,
}

impl std::ops::Add for CausticReport {
    type Output = CausticReport;
    fn add(self, o: CausticReport) -> CausticReport {
        CausticReport {
            seconds: self.seconds + o.seconds,
            photons_emitted: self.photons_emitted + o.photons_emitted,
            photons_stored: self.photons_stored + o.photons_stored,
            bytes: self.bytes + o.bytes,
        }
    }
}

impl Caustics {
    /// No map yet.
    pub fn new(settings: CausticSettings) -> Caustics {
        let (collected, report) = (Some(Vec::new()), CausticReport::default());
        Caustics { settings, emission: None, collected, pilot: None, pass: None, is_outdone: false, report }
    }

    /// What it took and holds.
    pub fn report(&self) -> CausticReport {
        self.report
    }

    /// The map of the last pass that was asked for; `None` where no light falls on anything specular.
    pub fn map(&self) -> Option<Arc<dyn FocusedLight>> {
        self.pass.as_ref()?.map.clone().map(|map| map as _)
    }

    /// What passes before that of the [map](Caustics::map) have shown is to be replaced: it was blurred over much more. True once.
    pub fn takes_back(&mut self) -> bool {
        std::mem::take(&mut self.is_outdone)
    }

    /// Makes the map of pass `number`, unless it is there. What was done stays when it is cancelled: asked again for the same
    /// pass, it goes on. The map does not depend on how often that was.
    pub fn prepare(&mut self, world: &World, number: u32, cancel: &AtomicBool) -> Progress {
        if self.pass.as_ref().is_some_and(|pass| pass.number == number && pass.map.is_some()) {
            return Progress { complete: true, ..Progress::default() };
        }
        let start = Instant::now();
        let emission = self.emission.get_or_insert_with(|| Emission::by_flux(world, &self.settings));
        if !emission.is_weighed && number >= self.settings.passes_by_flux {
            let has_passes = self.pass.is_some();
            if emission.weigh(world, &self.settings) {
                // They lie closer elsewhere.
                (self.collected, self.pilot) = (Some(Vec::new()), None);
                self.is_outdone = has_passes;
            }
        }
        if emission.lights.is_empty() {
            return Progress { complete: true, ..Progress::default() };
        }
        let is_begun = self.pass.as_ref().is_some_and(|pass| pass.number == number);
        let mut pass = match self.pass.take().filter(|_| is_begun) {
            Some(pass) => pass,
            None => {
                Pass { number, jobs: emission.jobs(number), photons: Vec::new(), corrected: None, map: None }
            }
        };
        let tracer = CausticTracer { world, settings: &self.settings };
        let mut counts = Counts { rays: std::mem::take(&mut emission.rays), ..Counts::default() };
        while !pass.jobs.is_empty() && !cancel.load(Ordering::Relaxed) {
            let batch = photons::take(&mut pass.jobs, BATCH);
            let traced = tracer.trace_all(&emission.lights, &batch, &mut pass.photons);
            counts.rays += traced.rays;
            self.report.photons_emitted += traced.photons;
        }
        if pass.jobs.is_empty() {
            counts.rays += self.finish(world, &mut pass, cancel);
        }
        let is_complete = pass.jobs.is_empty() && pass.photons.is_empty();
        self.pass = Some(pass);
        self.report.seconds += start.elapsed().as_secs_f64();
        Progress { counts, complete: is_complete }
    }

    /// Makes a map of what was followed; goes on where it was cut short. Returns how many rays that took.
    fn finish(&mut self, world: &World, pass: &mut Pass, cancel: &AtomicBool) -> u64 {
        let mut corrected = match pass.corrected {
            Some(corrected) => corrected,
            None => {
                self.report.photons_stored += pass.photons.len() as u64;
                self.learn_radii(&pass.photons);
                if let Some(pilot) = &self.pilot {
                    pilot.blur(&mut pass.photons, shrinking(pass.number) as f32);
                }
                0
            }
        };
        let key = self.settings.seed ^ u64::from(pass.number) << 32;
        let mut rays = 0;
        while corrected < pass.photons.len() && !cancel.load(Ordering::Relaxed) {
            let end = pass.photons.len().min(corrected + BATCH as usize);
            rays += borders::correct(world, &mut pass.photons[corrected..end], corrected, key);
            corrected = end;
        }
        pass.corrected = Some(corrected);
        if corrected == pass.photons.len() {
            let map = CausticMap::of(std::mem::take(&mut pass.photons), self.settings.light);
            let collected = self.collected.as_ref().map_or(0, Vec::len) * size_of::<CausticPhoton>();
            self.report.bytes =
                map.bytes() + self.pilot.as_ref().map_or(0, |pilot| pilot.bytes()) + collected;
            pass.map = Some(Arc::new(map));
        }
        rays
    }

    /// Photons of the first passes say how far all are blurred, as many of them as that takes.
    fn learn_radii(&mut self, photons: &[CausticPhoton]) {
        let Some(collected) = &mut self.collected else { return };
        collected.extend_from_slice(photons);
        let least_m = self.emission.as_ref().map_or(0.0, |emission| emission.least_extent_m);
        self.pilot = Some(Arc::new(Pilot::of(collected, least_m)));
        if collected.len() >= PILOT_PHOTONS {
            self.collected = None;
        }
    }
}

/// Area of a blur in shares of that in pass 0.
fn shrinking(pass: u32) -> f64 {
    (1..=pass).map(f64::from).fold(1.0, |area, i| area * (i + ALPHA) / (i + 1.0))
}

impl Emission {
    /// As for any pass after the first ones.
    fn of(world: &World, settings: &CausticSettings) -> Emission {
        let mut emission = Emission::by_flux(world, settings);
        emission.weigh(world, settings);
        emission
    }

    fn by_flux(world: &World, settings: &CausticSettings) -> Emission {
        let aim = targets::aim_of(world, settings.light);
        let mut sources = if aim.spheres.is_empty() { Vec::new() } else { world.sources() };
        let total_w: f64 = sources.iter().map(Source::power_w).sum();
        sources.retain(|source| settings.light == CausticLight::All || source.is_delta());
        // Of thousands of lights each is one of many: all together they are known as well.
        let points = (POINTS_OF_ALL / sources.len().max(1)).clamp(POINTS_OF_ONE[0], POINTS_OF_ONE[1]);
        let aimed: Vec<(Source, f64)> = sources
            .into_iter()
            .map(|source| {
                let power_w = world.power_towards_w(&source, &aim, points as u32);
                let least_w = MISSED * source.power_w() / points as f64;
                let is_seen = power_w > 0.0 && power_w.is_finite();
                (source, if is_seen { power_w } else { least_w })
            })
            .collect();
        let aimed_w: f64 = aimed.iter().map(|(_, power_w)| power_w).sum();
        let photon_w = (total_w / f64::from(settings.photons_per_pass.max(1)))
            .max(aimed_w / f64::from(settings.photons_max.max(1)));
        // What rough coats send on is as smooth as it is faint: of as many fewer photons each carries on, on average, what one by a mirror
        // does.
        let share = f64::from(world.sent_on_share());
        let few_w = (aimed_w / f64::from(SKETCH_PHOTONS)).max(photon_w);
        let photon_w = (photon_w / share).min(few_w);
        let lights = aimed.into_iter().map(|(source, power_w)| AimedLight {
            aim: aim.clone(),
            key: photons::key_of(settings.seed, source.name()),
            photon_count: power_w / photon_w,
            source,
        });
        let lights = lights.filter(|light| light.photon_count > 0.0).collect();
        // Blurs of what one sphere alone focuses are measured by it.
        let least_extent_m = aim.spheres.iter().map(|sphere| sphere.radius_m).fold(f32::INFINITY, f32::min);
        Emission { least_extent_m, lights, is_weighed: false, rays: 0 }
    }

    /// Spends its photons on what is seen. Returns whether that changes anything.
    fn weigh(&mut self, world: &World, settings: &CausticSettings) -> bool {
        let weighed = worth::weigh(world, settings, &mut self.lights);
        self.rays += weighed.rays;
        self.is_weighed = true;
        weighed.is_changed
    }

    /// Everything to be followed in a pass. Even and odd passes draw from sequences of their own: the two halves of a film must
    /// be independent.
    fn jobs(&self, pass: u32) -> Vec<Job> {
        let of_light = |(light, aimed): (usize, &AimedLight)| {
            let numbers = aimed.numbers(pass >> 1);
            (!numbers.is_empty()).then_some(Job { light, half: pass & 1, numbers })
        };
        self.lights.iter().enumerate().rev().filter_map(of_light).collect()
    }
}

impl Technique for Caustics {
    fn card(&self) -> &'static Card {
        &CARD
    }

    fn step(&mut self, step: &mut Step<'_>) -> Progress {
        let number = match &self.pass {
            Some(pass) if pass.map.is_some() => pass.number + 1,
            Some(pass) => pass.number,
            None => 0,
        };
        let progress = self.prepare(step.world, number, step.cancel);
        step.products.caustics = self.map();
        progress
    }

    fn apply(&mut self, _edit: &Edit<'_>) {
        // No photon outlives its pass; blurs begin anew, since what is focused where has changed.
        *self = Caustics { report: self.report, ..Caustics::new(self.settings) };
    }
}

/// Photons of pass 0, for measuring: as they fall, without a map.
pub fn photons_of_a_pass(world: &World, settings: &CausticSettings) -> Vec<CausticPhoton> {
    first_pass(world, settings).0
}

fn first_pass(world: &World, settings: &CausticSettings) -> (Vec<CausticPhoton>, Traced) {
    let emission = Emission::of(world, settings);
    let tracer = CausticTracer { world, settings };
    let mut photons = Vec::new();
    let traced = tracer.trace_all(&emission.lights, &emission.jobs(0), &mut photons);
    (photons, traced)
}
