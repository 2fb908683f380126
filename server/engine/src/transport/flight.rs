//! Flux on its way from a light: what the media it crosses and the surfaces it meets do to it.

use super::{Absorption, Bsdf, BsdfSample, Surface, World};
use crate::{
    accel::{Hit, Ray},
    math::Rgb,
};

/// A photon between two surfaces.
#[derive(Clone, Copy, Debug)]
pub struct Flight {
    /// Where it goes.
    pub ray: Ray,
    /// What it carries: flux, in whatever unit it began with.
    pub weight: Rgb,
    /// What it crosses; `None` in air and clear glass.
    medium: Option<Absorption>,
}

impl Flight {
    /// Surfaces after which it ends whatever it carries: light trapped by total reflection in lossless glass never would.
    pub const BOUNCES_END: u32 = 4096;

    /// From a light.
    pub fn begin(ray: Ray, weight: Rgb) -> Flight {
        Flight { ray, weight, medium: None }
    }

    /// The surface it meets. Takes off what the medium on the way there absorbs.
    pub fn arrive(&mut self, world: &World, hit: &Hit) -> Surface {
        let direction = self.ray.direction;
        let surface = world.surface(hit, direction);
        // Glass met from inside says what the ray came through; every other surface is met in what was entered last.
        if matches!(surface.bsdf, Bsdf::Glass(_)) && direction.dot(surface.frame.n) > 0.0 {
            self.medium = surface.inside;
        }
        if let Some(medium) = &self.medium {
            self.weight *= medium.transmittance(hit.t);
        }
        surface
    }

    /// How it goes on from a surface in the direction drawn there; `None` if it carries nothing.
    pub fn scattered(&self, surface: &Surface, drawn: &BsdfSample) -> Option<Flight> {
        let wo = -self.ray.direction;
        let wo_local = surface.frame.to_local(wo);
        let wi = surface.frame.to_world(drawn.wi);
        // The weight is that of radiance on its way to the eye; flux is not scaled where it enters a denser medium.
        let mut weight = self.weight * drawn.weight * drawn.eta_squared;
        // And the cosine that counts for flux is that of the surface, not of its bent normal [Veach1997, 5.3.2].
        let n_geo = surface.point.n_geo;
        let bent = (wo.dot(n_geo) * drawn.wi.z).abs();
        if bent > 0.0 {
            weight *= (wo_local.z * wi.dot(n_geo)).abs() / bent;
        }
        if !weight.is_finite() || !(weight.luminance() > 0.0) {
            return None;
        }
        let medium = match wo_local.z * drawn.wi.z < 0.0 {
            true if drawn.wi.z < 0.0 => surface.inside,
            true => None,
            false => self.medium,
        };
        Some(Flight { ray: surface.point.ray_towards(wi), weight, medium })
    }
}
