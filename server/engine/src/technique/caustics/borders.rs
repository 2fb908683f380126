//! What of a blur lies beyond the border of the surface that a photon fell on, given back to it.
//!
//! Of a disc that hangs over an edge, or reaches under what stands on the floor, only the share f lies where it is looked at,
//! and f of the flux would be seen. Points of the disc are drawn, as dense as the blur is strong, until one lies on a surface
//! in the open: that takes 1/f tries on average, and this is what the photon's flux is multiplied by. Within a plane the first
//! try always succeeds: this costs a short ray a photon.

use glam::Vec3;
use rayon::prelude::*;

use super::{
    map::{CausticPhoton, FLATNESS},
    photons,
};
use crate::{
    accel::Ray,
    math::{Frame, sobol},
    technique::FACING_COS,
    transport::World,
};

/// Tries at most: what lies on a sliver of a surface in a blur a hundred times as large stays too dark, and no photon is
/// ever multiplied by more.
const TRIES_END: u32 = 64;
/// Of the height that is free over a photon, the share from where its disc is looked at.
const FREE_SHARE: f32 = 0.5;
/// Surfaces that face other ways within a blur's height, at most.
const CROSSED_END: u32 = 4;

/// Multiplies the flux of photons, whose radii are known, by what makes up for the parts of their blurs that lie on nothing.
/// Returns how many rays that took.
///
/// - `key`: names the random numbers, other ones for every pass
pub(super) fn correct(world: &World, photons: &mut [CausticPhoton], key: u64) -> u64 {
    let key = sobol::mix(key);
    let correct = |(number, photon): (usize, &mut CausticPhoton)| {
        let mut blur = Blur::of(photon);
        let key = sobol::mix(key ^ number as u64);
        let is_found = |blur: &Blur, number: u32| blur.finds(world, sobol::point(key, number));
        if is_found(&blur, 0) {
            return 1;
        }
        // What hangs low over the photon would hide its own surface: looked at from below that, it is as if nothing was tried.
        let first = u32::from(!blur.lower(world));
        let Some(last) = (1..TRIES_END).find(|number| is_found(&blur, *number)) else {
            // Of which nothing is found lies on what is thinner than rounding: it stays as it is.
            return u64::from(TRIES_END) + 1;
        };
        photon.flux_w *= (last + first) as f32;
        u64::from(last) + 2
    };
    photons.par_iter_mut().enumerate().map(correct).sum()
}

/// The disc of a photon, looked at from some height.
struct Blur {
    centre: Vec3,
    frame: Frame,
    radius_m: f32,
    /// Of the photon's own surface it is the back: most likely of all that are seen.
    is_on_back: bool,
    /// In shares of the height where the blur ends.
    height: f32,
}

impl Blur {
    fn of(photon: &CausticPhoton) -> Blur {
        Blur {
            centre: photon.position,
            frame: Frame::around(photon.normal),
            radius_m: photon.radius_m,
            is_on_back: photon.is_on_back,
            height: 1.0,
        }
    }

    /// Looks from below what is above the photon; false where nothing is.
    fn lower(&mut self, world: &World) -> bool {
        let end_m = self.radius_m / FLATNESS;
        // From a little above, not to meet the surface itself.
        let lift_m = end_m / 64.0;
        let up = Ray { t_max: end_m, ..Ray::new(self.centre + self.frame.n * lift_m, self.frame.n) };
        let Some(hit) = world.closest_hit(&up) else { return false };
        self.height = FREE_SHARE * (lift_m + hit.t) / end_m;
        true
    }

    /// Whether a random point of it lies where light falls. Heights count as they do at look-ups.
    fn finds(&self, world: &World, [share, turn, strength, _]: [f32; 4]) -> bool {
        // 1 − d²/r² at the point.
        let kernel = (1.0 - share).sqrt();
        let (sin, cos) = (std::f32::consts::TAU * turn).sin_cos();
        let away =
            (self.frame.t * cos + self.frame.b * sin) * (self.radius_m * (1.0 - kernel).max(0.0).sqrt());
        // Lower than as far below, the blur ends.
        let end_m = self.radius_m * kernel.sqrt() / FLATNESS;
        let height_m = self.height * end_m;
        let down = -self.frame.n;
        let mut ray = Ray { t_max: height_m + end_m, ..Ray::new(self.centre + away - down * height_m, down) };
        for _ in 0..CROSSED_END {
            let Some(hit) = world.closest_hit(&ray) else { return false };
            let surface = world.surface(&hit, down);
            let cos = -down.dot(surface.point.n_geo);
            // From below or inside: what lies further on, under a foot or in a wall, nobody sees.
            if (cos < 0.0) != self.is_on_back {
                return false;
            }
            if cos.abs() >= FACING_COS {
                let above =
                    (surface.point.position - self.centre).dot(self.frame.n) * FLATNESS / self.radius_m;
                return strength * kernel < kernel - above * above && photons::is_shown_on(&surface);
            }
            let left_m = ray.t_max - hit.t;
            if !(left_m > 0.0) {
                return false;
            }
            ray = Ray { t_max: left_m, ..surface.point.ray_towards(down) };
        }
        false
    }
}
