//! Photons that something else carries from surface to surface, such as a graphics card.
//!
//! Where they start is drawn here, and what they leave behind becomes hits and paths here: a carrier's answers differ from the
//! CPU's by rounding alone. So of a scene that is edited or probed nothing is to be carried: paths are compared bit by bit there, with
//! what the CPU traces.

use std::fmt::Debug;

use glam::Vec3;

use super::{
    paths::{PhotonHit, PhotonPath},
    trace::{PhotonTracer, TraceTally},
};
use crate::{
    math::Rgb,
    transport::{EmittedPhoton, World},
};

/// Carries photons. `None` of it: nothing any more, or not in that world; the CPU traces then.
pub trait PhotonCarrier: Debug + Send + Sync {
    /// How many are best sent together.
    fn photons_at_once(&self) -> Option<usize>;

    /// Takes photons from surface to surface until they are absorbed, leave the scene, or have met `bounces_max` surfaces.
    fn carry(&self, world: &World, sent: &[SentPhoton], bounces_max: Option<u32>) -> Option<CarriedPhotons>;
}

/// A photon that leaves its light.
#[derive(Clone, Copy, Debug)]
pub struct SentPhoton {
    /// Where it goes, and what it carries in shares of its light's flux per photon.
    pub emitted: EmittedPhoton,
    /// At its scattering n ≥ 1 it draws [`crate::math::sobol::point`] of `key` + (n + 1) · golden ratio and `number`.
    pub key: u64,
    /// Among the photons of its light.
    pub number: u32,
}

/// What some photons left behind.
#[derive(Clone, Debug, Default)]
pub struct CarriedPhotons {
    /// Photon after photon, surface after surface.
    pub kept: Vec<KeptPhoton>,
    /// `[photons]`: where in `kept` what each left behind ends.
    pub ends: Vec<usize>,
}

impl CarriedPhotons {
    /// What a photon left behind.
    fn of(&self, photon: usize) -> &[KeptPhoton] {
        let first = photon.checked_sub(1).map_or(0, |before| self.ends[before]);
        &self.kept[first..self.ends[photon]]
    }
}

/// A photon at a surface, or on its way out of the scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KeptPhoton {
    /// Weights of the triangle's second and third corner.
    pub barycentric: [f32; 2],
    /// Index of the triangle.
    pub triangle: u32,
    /// As in [`PhotonHit`]; `None` of what met nothing.
    pub place: Option<u32>,
    /// With which it arrived.
    pub weight: Rgb,
    /// Luminance of what went on from there; 0 where it was absorbed.
    pub leaving: f32,
    /// Where it went, unit.
    pub direction: Vec3,
}

impl PhotonTracer<'_> {
    /// The path of a photon that asks for light that is not there.
    pub(super) fn nothing(hits: &[PhotonHit]) -> (PhotonPath, u64) {
        (PhotonPath::from(Vec3::ZERO, hits.len() as u32), 0)
    }

    /// As [`PhotonTracer::trace`], of a photon that was carried.
    pub(super) fn follow(
        &self,
        emitted: &EmittedPhoton,
        kept: &[KeptPhoton],
        hits: &mut Vec<PhotonHit>,
        tally: &mut TraceTally,
    ) -> (PhotonPath, u64) {
        let mut path = PhotonPath::from(emitted.ray.origin, hits.len() as u32);
        let (mut from, mut passed) = (emitted.ray.origin, 0);
        let mut leaving = f64::from(emitted.weight.luminance());
        tally.flux.emitted += leaving;
        for kept in kept {
            tally.rays += 1;
            let Some(place) = kept.place else {
                tally.flux.escaped += leaving;
                path.escape_towards(kept.direction);
                return (path, passed | self.grid.passed_towards(from, kept.direction));
            };
            let hit = PhotonHit::kept(self.world, kept, place);
            passed |= self.grid.passed(from, hit.position);
            from = hit.position;
            hits.push(hit);
            let arrived = f64::from(kept.weight.luminance());
            tally.flux.absorbed_on_the_way += leaving - arrived;
            leaving = f64::from(kept.leaving);
            tally.flux.absorbed += arrived - leaving;
        }
        tally.flux.cut_off += leaving;
        (path, passed)
    }
}

/// Photons that were sent off together.
pub(super) struct Sent {
    /// `[blocks][photons]`: what each began with; `None` for numbers that ask for light that is not there.
    emitted: Vec<Vec<Option<SentPhoton>>>,
    /// `[blocks]`: the first of each among those that were carried.
    firsts: Vec<usize>,
    carried: CarriedPhotons,
}

impl Sent {
    pub(super) fn new(emitted: Vec<Vec<Option<SentPhoton>>>, carried: CarriedPhotons) -> Sent {
        let mut next = 0;
        let first_of = |block: &Vec<Option<SentPhoton>>| {
            let first = next;
            next += block.iter().flatten().count();
            first
        };
        let firsts = emitted.iter().map(first_of).collect();
        Sent { emitted, firsts, carried }
    }

    /// What each photon of a block began with and left behind.
    pub(super) fn of_block(
        &self,
        block: usize,
    ) -> impl Iterator<Item = Option<(&EmittedPhoton, &[KeptPhoton])>> {
        let mut photon = self.firsts[block];
        self.emitted[block].iter().map(move |sent| {
            let sent = sent.as_ref()?;
            photon += 1;
            Some((&sent.emitted, self.carried.of(photon - 1)))
        })
    }
}
