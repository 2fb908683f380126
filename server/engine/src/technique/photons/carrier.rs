//! Photons that a [`crate::technique::PhotonCarrier`] took from surface to surface.
//!
//! Where they start is drawn here, and what they leave behind becomes hits and paths here.

use glam::Vec3;

use super::{
    paths::{PhotonHit, PhotonPath},
    trace::{PhotonTracer, TraceTally},
};
use crate::{
    technique::{CarriedPhotons, KeptPhoton, SentPhoton},
    transport::EmittedPhoton,
};

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
