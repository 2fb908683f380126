//! What of a blur lies beyond the border of the surface that a photon fell on, given back to it.
//!
//! Of a disc that hangs over an edge, or reaches under what stands on the floor, only the share f lies where it is looked at,
//! and f of the flux would be seen. Points of the disc are drawn, as dense as the blur is strong, until one lies on a surface
//! in the open: that takes 1/f tries on average, and this is what the photon's flux is multiplied by. Within a plane the first
//! try always succeeds: this costs two short rays a photon.

use glam::Vec3;
use rayon::prelude::*;

use super::{
    Sheet,
    map::{CausticPhoton, FACING_COS, FLATNESS},
    photons,
};
use crate::{
    accel::{Hit, Ray},
    math::{Frame, sobol},
    transport::World,
};

/// Tries at most: what lies on a sliver of a surface in a blur many times as large stays too dark, and no photon is ever
/// multiplied by more.
const TRIES_END: u32 = 32;
/// Of the height that is free over a photon, the share from where its disc is looked at.
const FREE_SHARE: f32 = 0.5;
/// Surfaces that face other ways within a blur's height, at most.
const CROSSED_END: u32 = 4;

/// Multiplies the flux of photons, whose radii are known, by what makes up for the parts of their blurs that lie on nothing.
/// Returns how many rays that took.
///
/// - `first`: number of the first of them in its pass
/// - `key`: names the random numbers, other ones for every pass
pub(super) fn correct(world: &World, photons: &mut [CausticPhoton], first: usize, key: u64) -> u64 {
    let key = sobol::mix(key);
    let correct = |(place, photon): (usize, &mut CausticPhoton)| {
        let key = sobol::mix(key ^ (first + place) as u64);
        let mut blur = Blur::over(world, photon);
        // Independent of each other: of evenly spread ones fewer would do on average than 1/f.
        let numbers = |number: u32| sobol::point(sobol::mix(key ^ u64::from(number)), 0);
        // A photon of which nothing is found lies on what is thinner than rounding: it stays as it is.
        if let Some(failed) = (0..TRIES_END).find(|number| blur.finds(numbers(*number))) {
            photon.flux_w *= (failed + 1) as f32;
        }
        blur.rays
    };
    photons.par_iter_mut().enumerate().map(correct).sum()
}

/// The disc of a photon, looked at from some height.
struct Blur<'a> {
    world: &'a World,
    photon: CausticPhoton,
    frame: Frame,
    /// In shares of the height where the blur ends.
    height: f32,
    rays: u64,
}

impl Blur<'_> {
    /// What hangs low over the photon would hide its own surface: it is looked at from below that.
    fn over<'a>(world: &'a World, photon: &CausticPhoton) -> Blur<'a> {
        let frame = Frame::around(photon.normal);
        let end_m = photon.radius_m / FLATNESS;
        // From a little above, not to meet the surface itself.
        let lift_m = end_m / 64.0;
        let up = Ray { t_max: end_m, ..Ray::new(photon.position + frame.n * lift_m, frame.n) };
        let above = world.closest_hit(&up);
        let height = above.map_or(1.0, |hit| FREE_SHARE * (lift_m + hit.t) / end_m);
        Blur { world, photon: *photon, frame, height, rays: 1 }
    }

    fn closest_hit(&mut self, ray: &Ray) -> Option<Hit> {
        self.rays += 1;
        self.world.closest_hit(ray)
    }

    /// Whether a random point of it lies where light falls. Heights count as they do at look-ups.
    fn finds(&mut self, [share, turn, strength, _]: [f32; 4]) -> bool {
        let CausticPhoton { position: centre, radius_m, .. } = self.photon;
        // 1 − d²/r² at the point.
        let kernel = (1.0 - share).sqrt();
        let (sin, cos) = (std::f32::consts::TAU * turn).sin_cos();
        let away = (self.frame.t * cos + self.frame.b * sin) * (radius_m * (1.0 - kernel).max(0.0).sqrt());
        // Lower than as far below, the blur ends.
        let end_m = radius_m * kernel.sqrt() / FLATNESS;
        let height_m = self.height * end_m;
        let down = -self.frame.n;
        let start = centre + away - down * height_m;
        let mut ray = Ray { t_max: height_m + end_m, ..Ray::new(start, down) };
        for _ in 0..CROSSED_END {
            let Some(hit) = self.closest_hit(&ray) else { return false };
            let surface = self.world.surface(&hit, down);
            let cos = -down.dot(surface.point.n_geo);
            if cos.abs() >= FACING_COS {
                let above = (surface.point.position - centre).dot(self.frame.n) * FLATNESS / radius_m;
                return strength * kernel < kernel - above * above
                    && photons::is_shown_on(&surface)
                    && self.is_in_the_open(&hit, cos, start);
            }
            let left_m = ray.t_max - hit.t;
            if !(left_m > 0.0) {
                return false;
            }
            ray = Ray { t_max: left_m, ..surface.point.ray_towards(down) };
        }
        false
    }

    /// Met on the other side than the photon's own surface, it may be the bottom of what stands there, seen from inside. It is
    /// not where the way from over the photon is free, and where both belong together whatever way their triangles turn.
    fn is_in_the_open(&mut self, hit: &Hit, cos: f32, start: Vec3) -> bool {
        let primitive = self.world.primitive_of(hit);
        if (cos < 0.0) == self.photon.is_on_back
            || Sheet::of(hit.instance, primitive, self.frame.n) == self.photon.sheet
        {
            return true;
        }
        let height_m = self.height * self.photon.radius_m / FLATNESS;
        let from = self.photon.position + self.frame.n * height_m;
        let way = Ray { t_max: 1.0, ..Ray::new(from, start - from) };
        self.closest_hit(&way).is_none()
    }
}
