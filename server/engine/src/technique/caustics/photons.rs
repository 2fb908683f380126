//! Photons that are followed by specular lobes alone, until they carry nothing more.

use std::ops::Range;

use glam::Vec3;
use rayon::prelude::*;

use super::{AimedLight, CausticLight, CausticSettings, map::CausticPhoton, pilot::Sheet};
use crate::{
    math::sobol,
    transport::{AimedPhoton, EmissionNumbers, Flight, Passed, Source, SourceName, Surface, World},
};

/// Share of what it began with that a photon carries until roulette may end it: a coat of varnish sends on a twentieth, and
/// faint photons cost little beside noise.
const ROULETTE_SHARE: f32 = 1.0 / 32.0;
/// Photons that a thread takes at a time.
const CHUNK: u32 = 512;
/// Of the n-th surface that shows a photon it is kept on so many in n: on 17 of 4,096 in the mean, which bounds memory where
/// next to no light is lost. What is kept carries as much more.
const STORED_SURELY: f32 = 2.0;
const GOLDEN_RATIO: f32 = 0.618_034;

/// What photons need to know besides their light.
#[derive(Clone, Copy)]
pub(super) struct CausticTracer<'a> {
    pub(super) world: &'a World,
    pub(super) settings: &'a CausticSettings,
}

/// Names the numbers of a light's photons; its last bit is free.
pub(super) fn key_of(seed: u64, name: &SourceName) -> u64 {
    let (id, part) = match name {
        SourceName::Punctual(id) => (id.as_str(), 0),
        SourceName::Surface(id, primitive) => (id.as_str(), 2 + u64::from(*primitive)),
        SourceName::Environment => ("", 1),
    };
    let begin = sobol::mix(seed ^ 0x6361_7573_7469_6373);
    let letters = id.bytes().fold(begin, |key, letter| sobol::mix(key ^ u64::from(letter)));
    sobol::mix(letters ^ part) << 1
}

/// Four numbers of a photon, for what it does as `set`.
fn four(key: u64, set: u32, number: u32) -> [f32; 4] {
    sobol::point(key.wrapping_add(u64::from(set) << 1), number)
}

/// The numbers by which a photon leaves its light.
///
/// - `key`: of its sequence
pub(super) fn emission_of(key: u64, number: u32) -> EmissionNumbers {
    let ([u, v, s, t], [side, ..]) = (four(key, 0, number), four(key, 1, number));
    EmissionNumbers { direction: [u, v], position: [s, t], side }
}

/// Photons of one light that are to be followed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Job {
    /// Place of the light.
    pub(super) light: usize,
    /// Which of its sequences they draw from.
    pub(super) half: u32,
    pub(super) numbers: Range<u64>,
}

/// Takes jobs of `count` photons off the end.
pub(super) fn take(jobs: &mut Vec<Job>, count: u32) -> Vec<Job> {
    let mut left = u64::from(count);
    let mut taken = Vec::new();
    while let Some(last) = jobs.last_mut().filter(|_| left > 0) {
        let Range { start, end } = last.numbers;
        let middle = end.min(start + left);
        left -= middle - start;
        taken.push(Job { numbers: start..middle, ..*last });
        last.numbers.start = middle;
        if middle == end {
            jobs.pop();
        }
    }
    taken
}

/// How light came to where it fell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Came {
    /// Straight through panes from infinitely far, where light sampling finds it ([`World::through_panes`]).
    ByPanes,
    /// By way of mirrors or glass that turn it.
    Focused,
}

/// Keeps what maps are to hold.
pub(super) fn focused_into(photons: &mut Vec<CausticPhoton>) -> impl FnMut(Came, CausticPhoton) {
    |came, photon| photons.extend((came == Came::Focused).then_some(photon))
}

/// What following took.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Traced {
    pub(super) photons: u64,
    pub(super) rays: u64,
}

impl CausticTracer<'_> {
    /// Follows the photons of some jobs and adds what falls on surfaces that show it.
    pub(super) fn trace_all(
        &self,
        lights: &[AimedLight],
        jobs: &[Job],
        photons: &mut Vec<CausticPhoton>,
    ) -> Traced {
        let mut pieces = jobs.to_vec();
        pieces.reverse();
        let mut small = Vec::new();
        while !pieces.is_empty() {
            small.push(take(&mut pieces, CHUNK));
        }
        let follow = |jobs: Vec<Job>| {
            let (mut photons, mut traced) = (Vec::new(), Traced::default());
            for job in jobs {
                let light = &lights[job.light];
                for number in job.numbers {
                    traced.photons += 1;
                    traced.rays += self.trace(light, job.half, number as u32, focused_into(&mut photons));
                }
            }
            (photons, traced)
        };
        // In order: maps do not depend on the threads.
        let chunks: Vec<(Vec<CausticPhoton>, Traced)> = small.into_par_iter().map(follow).collect();
        chunks.into_iter().fold(Traced::default(), |sum, (of_chunk, traced)| {
            photons.extend(of_chunk);
            Traced { photons: sum.photons + traced.photons, rays: sum.rays + traced.rays }
        })
    }

    /// Sends one out and follows it; as [`CausticTracer::follow`].
    pub(super) fn trace(
        &self,
        light: &AimedLight,
        half: u32,
        number: u32,
        fell: impl FnMut(Came, CausticPhoton),
    ) -> u64 {
        let key = light.key ^ u64::from(half);
        let numbers = emission_of(key, number);
        let Some(emitted) = self.world.emit_at(&light.source, &light.aim, &numbers) else { return 0 };
        let flux_w = emitted.flux_w * (1.0 / light.photon_count) as f32;
        let emitted = AimedPhoton { flux_w, ..emitted };
        self.follow(&light.source, emitted, (key, number), fell)
    }

    /// Follows one photon. Returns how many rays that took.
    ///
    /// - `emitted`: its first ray, and what it carries, W
    /// - `named`: its sequence and its number in it
    /// - `fell`: called with what falls on surfaces that show it
    pub(super) fn follow(
        &self,
        source: &Source,
        emitted: AimedPhoton,
        named: (u64, u32),
        mut fell: impl FnMut(Came, CausticPhoton),
    ) -> u64 {
        let four = |set: u32| four(named.0, set, named.1);
        let [_, chance, ..] = four(1);
        let mut flight = Flight::begin(emitted.ray, emitted.flux_w);
        let faint = ROULETTE_SHARE * flight.weight.luminance();
        let bounces_end = self.settings.bounces_max.unwrap_or(Flight::BOUNCES_END).min(Flight::BOUNCES_END);
        let mut shown_count = 0;
        let mut passed = source.is_infinite().then(|| Passed::nothing(flight.ray.direction));
        for bounce in 0..bounces_end {
            let Some(hit) = self.world.closest_hit(&flight.ray) else { return u64::from(bounce) + 1 };
            let surface = flight.arrive(self.world, &hit);
            let towards_light = -flight.ray.direction;
            let came = match passed {
                Some(passed) if passed.is_straight(flight.ray.direction) => Came::ByPanes,
                _ => Came::Focused,
            };
            if bounce > 0 && is_shown_on(&surface) {
                shown_count += 1;
                // Evenly spread over the counts, by one number for all of them.
                let kept = (STORED_SURELY / shown_count as f32).min(1.0);
                if (chance + shown_count as f32 * GOLDEN_RATIO).fract() < kept {
                    let faces = facing(&surface, towards_light);
                    let photon = CausticPhoton {
                        position: surface.point.position,
                        radius_m: 0.0,
                        flux_w: flight.weight * (1.0 / kept),
                        direction: towards_light,
                        normal: faces,
                        sheet: Sheet::of(hit.instance, self.world.primitive_of(&hit), faces),
                        scatterings: bounce as u16,
                        is_on_back: towards_light.dot(surface.point.n_geo) < 0.0,
                    };
                    fell(came, photon);
                }
            }
            let [lobe, u, v, survival] = four(2 + bounce);
            let wo_local = surface.frame.to_local(towards_light);
            let drawn = surface.bsdf.sample_specular(wo_local, [lobe, u, v]).filter(|drawn| {
                surface.reflects_photons_of(towards_light)
                    && surface.may_scatter(towards_light, surface.frame.to_world(drawn.wi))
            });
            passed = passed.zip(drawn).and_then(|(passed, drawn)| passed.after(wo_local, &drawn));
            // From a lobe with a width light that comes straight or through panes is sampled.
            let is_sampled = bounce == 0 || came == Came::ByPanes;
            let is_hidden = !is_sampled || drawn.is_some_and(|drawn| drawn.pdf_solid_angle.is_none());
            let drawn = drawn.filter(|_| is_hidden || self.settings.light == CausticLight::All);
            let Some(mut next) = drawn.and_then(|drawn| flight.scattered(&surface, &drawn)) else {
                return u64::from(bounce) + 1;
            };
            let survives = next.weight.luminance() / faint;
            if survives < 1.0 {
                if survival >= survives {
                    return u64::from(bounce) + 1;
                }
                next.weight *= 1.0 / survives;
            }
            flight = next;
        }
        u64::from(bounces_end)
    }
}

/// Whether a surface shows what falls on it.
pub(super) fn is_shown_on(surface: &Surface) -> bool {
    surface.bsdf.has_diffuse() || surface.bsdf.has_broad_gloss()
}

/// The true normal on the side of a direction.
pub(super) fn facing(surface: &Surface, direction: Vec3) -> Vec3 {
    let n_geo = surface.point.n_geo;
    if direction.dot(n_geo) > 0.0 { n_geo } else { -n_geo }
}
