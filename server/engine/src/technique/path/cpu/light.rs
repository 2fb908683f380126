//! Light that paths find of the lights themselves: by chance where they go, and by sampling a light from every surface that has a density;
//! each weighed by what the other would have brought.

use glam::Vec3;

use super::{Followed, LastVertex, Path, Tracer};
use crate::{
    accel::Hit,
    film::PixelSample,
    technique::{Guidance, path::Tally},
    transport::{Opening, Scatter, Surface, Through, bsdf::LobeValue},
};

/// Power heuristic for one sample of each of two densities [Veach1997, 9.2.4], safe where squares overflow.
pub(super) fn power_heuristic(pdf: f32, other: f32) -> f32 {
    if pdf >= other {
        let ratio = other / pdf;
        1.0 / (1.0 + ratio * ratio)
    } else {
        let ratio = pdf / other;
        ratio * ratio / (1.0 + ratio * ratio)
    }
}

impl Tracer<'_> {
    /// Of what shines around the scene, along the ray that left it.
    pub(super) fn add_environment(&self, path: &Path<'_>, sample: &mut PixelSample) {
        let radiance = self.world.environment_radiance(path.ray.direction);
        if radiance.is_black() {
            return;
        }
        let is_sampled =
            |last: &&LastVertex| last.passed.boundaries == 0 || last.passed.is_straight(path.ray.direction);
        let weight = path.last.as_ref().filter(is_sampled).map_or(1.0, |last| {
            let light_pdf = self.world.lights().pdf_of_environment(
                last.n,
                self.opening_at(last.position, last.n),
                last.way,
            );
            power_heuristic(last.pdf_solid_angle, light_pdf)
        });
        sample.radiance[path.class as usize] += path.throughput * radiance * weight;
    }

    /// Of the surface that the ray met, which may show its colour unlit.
    pub(super) fn add_emission(
        &self,
        path: &Path<'_>,
        hit: &Hit,
        surface: &Surface,
        sample: &mut PixelSample,
    ) {
        if !path.class.meets_diffuse() && !surface.unlit.is_black() {
            sample.radiance[path.class as usize] += path.throughput * surface.unlit;
        }
        if surface.emitted.is_black() || self.has_gathered(path, 2) {
            return;
        }
        // Lights nearby are not sampled through panes.
        let weight = path.last.as_ref().filter(|last| last.passed.boundaries == 0).map_or(1.0, |last| {
            let light_pdf = self.world.lights().pdf_of_triangle(
                last.position,
                last.n,
                path.ray.direction,
                hit,
                &surface.point,
            );
            power_heuristic(last.pdf_solid_angle, light_pdf)
        });
        sample.radiance[path.class as usize] += path.throughput * surface.emitted * weight;
    }

    /// Where the sky shows, as light sampling knows it.
    fn opening_at(&self, p: Vec3, n: Vec3) -> Option<&Opening> {
        let through = match self.samples_sky_through_panes() {
            true => Through::HolesAndPanes,
            false => Through::Holes,
        };
        if self.settings.knows_openings { self.world.opening_at(p, n, through) } else { None }
    }

    /// Light sampling: one light, each lobe weighed by itself.
    ///
    /// - `followed`: the rays that go on from here, which light sampling competes with
    /// - `guidance`: what they are drawn by
    pub(super) fn add_light_sample(
        &self,
        path: &Path<'_>,
        surface: &Surface,
        (followed, guidance): (Followed, Option<&Guidance<'_>>),
        sample: &mut PixelSample,
        tally: &mut impl Tally,
    ) {
        if !surface.bsdf.has_density() {
            return;
        }
        let [choice, u, v, _] = path.sampler.four(2 + 2 * path.bounce);
        let n = surface.frame.n;
        let lights = self.world.lights();
        // Glass bases scatter to the side they are seen from, which the frame's normal need not be on.
        let facing = if path.ray.direction.dot(n) > 0.0 { -n } else { n };
        let p = surface.point.position;
        let opening = || self.opening_at(p, facing);
        let Some(light) = lights.sample(self.world.accel(), p, facing, opening, [choice, u, v]) else {
            return;
        };
        let wo = -path.ray.direction;
        let mut value = surface.bsdf.eval(surface.frame.to_local(wo), surface.frame.to_local(light.wi));
        let is_dark = value.diffuse.f_cos.is_black() && value.glossy.f_cos.is_black();
        if is_dark || !surface.may_scatter(wo, light.wi) {
            return;
        }
        let Some((radiance, shadow_ray)) = self.world.towards_light(&surface.point, &light) else { return };
        tally.shadow_ray(&shadow_ray);
        let is_occluded = self.world.is_occluded(&shadow_ray);
        let behind = is_occluded.then(|| self.shown_through_panes(path, surface, &light)).flatten();
        if is_occluded && behind.is_none() {
            return;
        }
        if let Some(guidance) = guidance.filter(|_| !light.is_delta) {
            value.diffuse.pdf_solid_angle *= guidance.ratio(light.wi, light.wi.dot(facing).abs());
        }
        if let Some(shown) = behind {
            let arriving = path.throughput * radiance * (1.0 / light.pdf);
            self.add_through_panes(path, (&light, &shadow_ray, arriving), (&value, shown), sample, tally);
            return;
        }
        let arriving = path.throughput * radiance * (1.0 / light.pdf) * path.transmittance(&shadow_ray);
        let mut add = |lobe: &LobeValue, scatter| {
            let weight = if light.is_delta { 1.0 } else { power_heuristic(light.pdf, lobe.pdf_solid_angle) };
            let class = path.class.after(scatter);
            let (weight, is_wanted) = match followed {
                Followed::Wanted => {
                    let is_gathered = scatter == Scatter::Specular && self.has_gathered(path, 1);
                    (weight, self.settings.traced.contains(class) && !is_gathered)
                }
                // Light straight to a glossy lobe is a caustic of the near surface before, and known there.
                Followed::All => (weight, scatter == Scatter::Diffuse),
                Followed::Specular => (1.0, scatter == Scatter::Diffuse),
            };
            if is_wanted {
                sample.radiance[class as usize] += arriving * lobe.f_cos * weight;
            }
        };
        add(&value.diffuse, Scatter::Diffuse);
        add(&value.glossy, Scatter::Specular);
    }
}
