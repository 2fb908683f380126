//! Photons that something else than the CPU carries from surface to surface, such as a graphics card: what is sent, and what comes back.
//!
//! A carrier's answers differ from the CPU's by rounding alone. So of a scene that is edited or probed nothing is to be carried: paths
//! are compared bit by bit there, with what the CPU traces.

use std::fmt::Debug;

use glam::Vec3;

use crate::{
    math::Rgb,
    transport::{EmittedPhoton, World},
};

/// Bits of the marks of a photon at a surface, below the index of the instance; scenes hold fewer instances than the rest can count.
pub const PHOTON_MARK_BITS: u32 = 4;
/// It fell on the triangle's front.
pub const PHOTON_MARK_FRONT: u32 = 4;
/// The surface has a diffuse lobe that can show it.
pub const PHOTON_MARK_DIFFUSE: u32 = 8;

/// Highest chance of going on. Where no light is lost a photon is kept at every surface it meets until chance ends it, after 100
/// in the mean; a lower chance would turn the light of bright rooms into few, ever heavier photons: their second moment grows
/// by ρ² over the chance with every surface.
pub const PHOTON_SURVIVAL_MAX: f32 = 0.99;

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
    pub fn of(&self, photon: usize) -> &[KeptPhoton] {
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
    /// Index of the instance above [`PHOTON_MARK_BITS`] marks: two for the class, one for the front, one for a diffuse lobe. `None` of
    /// what met nothing.
    pub place: Option<u32>,
    /// With which it arrived.
    pub weight: Rgb,
    /// Luminance of what went on from there; 0 where it was absorbed.
    pub leaving: f32,
    /// Where it went, unit.
    pub direction: Vec3,
}
