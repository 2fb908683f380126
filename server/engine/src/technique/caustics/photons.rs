//! Photons that are followed by specular lobes alone, until they carry nothing more.

use rayon::prelude::*;

use super::{CausticLight, CausticSettings, map::CausticPhoton};
use crate::{
    math::{octahedral, sobol},
    transport::{Aim, EmissionNumbers, Flight, Source, SourceName, World},
};

/// A photon ends here whatever it carries: light trapped by total reflection in lossless glass never would.
const BOUNCES_END: u32 = 4096;
/// Share of what it began with that a photon carries until roulette may end it: a coat of varnish sends on a twentieth, and
/// faint photons cost little beside noise.
const ROULETTE_SHARE: f32 = 1.0 / 32.0;
/// Photons that a thread takes at a time.
const CHUNK: u32 = 1024;

/// What photons need to know besides their light.
#[derive(Clone, Copy)]
pub(super) struct CausticTracer<'a> {
    pub(super) world: &'a World,
    pub(super) aim: &'a Aim,
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

impl CausticTracer<'_> {
    /// The photons of a pass of one light where they fell on diffuse surfaces, and the rays that took.
    ///
    /// - `pass`: of those that draw from `key`
    pub(super) fn trace_all(
        &self,
        source: &Source,
        key: u64,
        pass: u32,
        count: u32,
    ) -> (Vec<CausticPhoton>, u64) {
        let chunks: Vec<(Vec<CausticPhoton>, u64)> = (0..count.div_ceil(CHUNK))
            .into_par_iter()
            .map(|chunk| {
                let (mut photons, mut rays) = (Vec::new(), 0);
                for number in chunk * CHUNK..((chunk + 1) * CHUNK).min(count) {
                    let number = pass.wrapping_mul(count).wrapping_add(number);
                    rays += self.trace(source, key, number, 1.0 / count as f32, &mut photons);
                }
                (photons, rays)
            })
            .collect();
        let rays = chunks.iter().map(|(_, rays)| rays).sum();
        (chunks.into_iter().flat_map(|(photons, _)| photons).collect(), rays)
    }

    fn trace(
        &self,
        source: &Source,
        key: u64,
        number: u32,
        share: f32,
        photons: &mut Vec<CausticPhoton>,
    ) -> u64 {
        let four = |set: u32| sobol::point(key.wrapping_add(u64::from(set) << 1), number);
        let ([u, v, s, t], [side, ..]) = (four(0), four(1));
        let numbers = EmissionNumbers { direction: [u, v], position: [s, t], side };
        let Some(emitted) = self.world.emit_at(source, self.aim, &numbers) else { return 0 };
        let mut flight = Flight::begin(emitted.ray, emitted.flux_w * share);
        let faint = ROULETTE_SHARE * flight.weight.luminance();
        let bounces_end = self.settings.bounces_max.unwrap_or(BOUNCES_END).min(BOUNCES_END);
        for bounce in 0..bounces_end {
            let Some(hit) = self.world.closest_hit(&flight.ray) else { return u64::from(bounce) + 1 };
            let surface = flight.arrive(self.world, &hit);
            let towards_light = -flight.ray.direction;
            if bounce > 0 && (surface.bsdf.has_diffuse() || surface.bsdf.has_broad_gloss()) {
                let n_geo = surface.point.n_geo;
                let normal = if towards_light.dot(n_geo) > 0.0 { n_geo } else { -n_geo };
                photons.push(CausticPhoton {
                    position: surface.point.position,
                    radius_m: 0.0,
                    flux_w: flight.weight,
                    direction: octahedral::encode(towards_light),
                    normal: octahedral::encode(normal),
                });
            }
            let [lobe, u, v, survival] = four(2 + bounce);
            let drawn = surface.bsdf.sample_specular(surface.frame.to_local(towards_light), [lobe, u, v]);
            // From a lobe with a width the light itself is sampled.
            let is_hidden = bounce > 0 || drawn.is_some_and(|drawn| drawn.pdf_solid_angle.is_none());
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
