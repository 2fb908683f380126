//! Caustics: light that only mirrors and glass sent on before it falls on a diffuse surface (LS+DE), by photons of its own.
//!
//! Photons are aimed at what reflects or refracts, and nothing else (`targets.rs`, [`crate::transport::Aim`]), and followed
//! by specular lobes alone (`photons.rs`). Every pass over a picture gets a map of its own, with smaller blurs than the one
//! before; the mean over passes goes to the truth without any photon being kept [Hachisuka2008; Knaus2011] (`map.rs`). How
//! far a photon is blurred follows from how close photons lay in a first map: little in a focus, more where few fall
//! [Larsen2004, 12; Silverman1986, 5.3].
//!
//! Photons carry as much flux each as if all lights had sent them out blindly: what this costs is in proportion to the share
//! of the light that falls on mirrors and glass. Where there are none it costs nothing.
//!
//! **Consistent**: blurs in every finite picture, also over borders. It sees light of point, spot and directional lights
//! by way of mirrors and clear glass, which no path from the eye can find; and can be asked for that alone.

mod map;
mod photons;
mod targets;
#[cfg(test)]
mod tests;

use std::{
    sync::{Arc, atomic::Ordering},
    time::Instant,
};

pub use map::CausticMap;

use self::{
    map::{CausticPhoton, Pilot},
    photons::CausticTracer,
};
use super::{Bias, Card, Counts, Edit, Progress, Step, Technique};
use crate::transport::{Aim, PathClass, Source, World};

/// Which light is followed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum CausticLight {
    /// All of it.
    #[default]
    All,
    /// Light that no path from the eye can find: of lights without size, by a mirror or clear glass first.
    Hidden,
}

/// Parameters of caustics.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CausticSettings {
    /// Photons of a pass if all the light of the scene fell on mirrors and glass; as many fewer as less does.
    pub photons_per_pass: u32,
    /// Photons of a pass at most.
    pub photons_max: u32,
    /// Most surfaces that a photon reaches; `None`: no bound.
    pub bounces_max: Option<u32>,
    /// Names the random numbers.
    pub seed: u64,
    /// Which light is followed.
    pub light: CausticLight,
}

impl CausticSettings {
    /// For a picture of so many pixels.
    pub fn of(pixel_count: usize, bounces_max: Option<u32>, seed: u64) -> CausticSettings {
        let pixels = u32::try_from(pixel_count).unwrap_or(u32::MAX);
        CausticSettings {
            photons_per_pass: pixels.saturating_mul(PHOTONS_PER_PIXEL).min(PHOTONS_END),
            photons_max: (pixels / PIXELS_PER_PHOTON).clamp(PHOTONS_LEAST, PHOTONS_END),
            bounces_max,
            seed,
            light: CausticLight::All,
        }
    }
}

/// Photons of a pass for every pixel, if all light fell on mirrors and glass.
const PHOTONS_PER_PIXEL: u32 = 2;
/// Pixels for every photon of a pass, at least: following photons takes less time than following the eye's paths. Twice or
/// half as many made no difference to the error after ten seconds.
const PIXELS_PER_PHOTON: u32 = 4;
/// Photons of a pass in the smallest pictures, and in the largest: 64 bytes each.
const PHOTONS_LEAST: u32 = 1 << 12;
const PHOTONS_END: u32 = 1 << 20;

/// Photons that are tried to find how much of all light falls on mirrors and glass, and of one light at least and at most.
const POINTS_OF_ALL: usize = 1 << 15;
const POINTS_OF_ONE: [usize; 2] = [16, 512];

/// How fast blurs shrink: the area of pass i + 1 is (i + α) / (i + 1) of that of pass i; 1 would be not at all [Knaus2011].
const ALPHA: f64 = 0.6;

static CARD: Card = Card { name: "caustics", classes: &[PathClass::Caustic], bias: Bias::Consistent };

/// A map of caustics for every pass, on the CPU, on the rayon pool it is called in.
#[derive(Debug)]
pub struct Caustics {
    settings: CausticSettings,
    /// What photons start from; `None` before the first step.
    emission: Option<Emission>,
    pilot: Option<Arc<Pilot>>,
    /// Maps made so far.
    passes: u32,
    /// Area of a blur in shares of that in the first pass.
    shrinking: f64,
    report: CausticReport,
}

/// What photons start from.
#[derive(Debug)]
struct Emission {
    aim: Aim,
    /// Lights that reach something specular, the flux of one photon of each and how many there are.
    lights: Vec<AimedLight>,
}

#[derive(Debug)]
struct AimedLight {
    source: Source,
    key: u64,
    photon_count: u32,
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

/// What it took and holds.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CausticReport {
    /// Seconds of following photons and of making maps.
    pub seconds: f64,
    /// Photons sent out in all passes.
    pub photons_emitted: u64,
    /// Of those, and of what they became, what fell on diffuse surfaces.
    pub photons_stored: u64,
    /// Bytes of the newest map and of what says how far photons are blurred.
    pub bytes: usize,
}

impl Caustics {
    /// No map yet.
    pub fn new(settings: CausticSettings) -> Caustics {
        Caustics {
            settings,
            emission: None,
            pilot: None,
            passes: 0,
            shrinking: 1.0,
            report: CausticReport::default(),
        }
    }

    /// What it took and holds.
    pub fn report(&self) -> CausticReport {
        self.report
    }

    /// The map of the next pass and the work it took; `None` where no light falls on anything specular.
    fn next_map(&mut self, world: &World) -> (Option<Arc<CausticMap>>, Counts) {
        let emission = self.emission.get_or_insert_with(|| Emission::of(world, &self.settings));
        if emission.lights.is_empty() {
            return (None, Counts::default());
        }
        let tracer = CausticTracer { world, aim: &emission.aim, settings: &self.settings };
        // Even and odd passes draw from sequences of their own: the two halves of a film must be independent.
        let (half, index) = (u64::from(self.passes & 1), self.passes >> 1);
        let mut photons = Vec::new();
        let mut counts = Counts::default();
        for light in &emission.lights {
            let (traced, rays) = tracer.trace_all(&light.source, light.key ^ half, index, light.photon_count);
            photons.extend(traced);
            counts.rays += rays;
            self.report.photons_emitted += u64::from(light.photon_count);
        }
        self.report.photons_stored += photons.len() as u64;
        let pilot = self.pilot.get_or_insert_with(|| Arc::new(Pilot::of(&photons)));
        let map = Arc::new(CausticMap::of(photons, pilot, self.shrinking as f32));
        self.report.bytes = map.bytes() + pilot.bytes();
        self.passes += 1;
        let pass = f64::from(self.passes);
        self.shrinking *= (pass + ALPHA) / (pass + 1.0);
        (Some(map), counts)
    }
}

impl Emission {
    fn of(world: &World, settings: &CausticSettings) -> Emission {
        let aim = targets::aim_of(world);
        let sources = if aim.spheres.is_empty() { Vec::new() } else { world.sources() };
        let total_w: f64 = sources.iter().map(Source::power_w).sum();
        // Of thousands of lights each is one of many: all together they are known as well.
        let points = (POINTS_OF_ALL / sources.len().max(1)).clamp(POINTS_OF_ONE[0], POINTS_OF_ONE[1]) as u32;
        let aimed: Vec<(Source, f64)> = sources
            .into_iter()
            .filter(|source| settings.light == CausticLight::All || source.is_delta())
            .map(|source| {
                let power_w = world.power_towards_w(&source, &aim, points);
                (source, power_w)
            })
            .filter(|(_, power_w)| *power_w > 0.0 && power_w.is_finite())
            .collect();
        let aimed_w: f64 = aimed.iter().map(|(_, power_w)| power_w).sum();
        let photon_w = (total_w / f64::from(settings.photons_per_pass.max(1)))
            .max(aimed_w / f64::from(settings.photons_max.max(1)));
        let lights = aimed.into_iter().map(|(source, power_w)| AimedLight {
            key: photons::key_of(settings.seed, source.name()),
            photon_count: (power_w / photon_w).ceil().clamp(1.0, f64::from(settings.photons_max)) as u32,
            source,
        });
        Emission { lights: lights.collect(), aim }
    }
}

impl Technique for Caustics {
    fn card(&self) -> &'static Card {
        &CARD
    }

    fn step(&mut self, step: &mut Step<'_>) -> Progress {
        if step.cancel.load(Ordering::Relaxed) {
            return Progress::default();
        }
        let start = Instant::now();
        let (map, counts) = self.next_map(step.world);
        if map.is_some() {
            self.report.seconds += start.elapsed().as_secs_f64();
        }
        step.products.caustics = map.map(|map| map as _);
        Progress { counts, complete: true }
    }

    fn apply(&mut self, _edit: &Edit<'_>) {
        // No photon outlives its pass; blurs begin anew, since what is focused where has changed.
        *self = Caustics { report: self.report, ..Caustics::new(self.settings) };
    }
}

/// Photons of one step, for measuring: as they fall, without a map.
pub fn photons_of_a_pass(world: &World, settings: &CausticSettings) -> Vec<CausticPhoton> {
    let emission = Emission::of(world, settings);
    let tracer = CausticTracer { world, aim: &emission.aim, settings };
    let of_light = |light: &AimedLight| tracer.trace_all(&light.source, light.key, 0, light.photon_count).0;
    emission.lights.iter().flat_map(of_light).collect()
}
