//! Light that paths find of the lights themselves: by chance where they go, and by sampling a light from every surface that has a density;
//! each weighed by what the other would have brought.

use glam::Vec3;

use super::{Followed, LastVertex, Path, ShownFocused, Tracer};
use crate::{
    accel::Hit,
    film::PixelSample,
    math::Rgb,
    technique::{Guidance, LeftToSampling, path::Tally},
    transport::{
        BsdfValue, LightOrigin, LightSample, Opening, PathClass, Scatter, ShadowRay, Surface, Through,
        bsdf::LobeValue,
    },
};

/// Power heuristic for one sample of each of two densities [Veach1997, 9.2.4], safe where squares overflow.
fn power_heuristic(pdf: f32, other: f32) -> f32 {
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
        if path.class == PathClass::Emitted && !surface.unlit.is_black() {
            sample.radiance[PathClass::Emitted as usize] += path.throughput * surface.unlit;
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
                hit.instance,
                hit.triangle,
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
        if value.diffuse.f_cos.is_black() && value.glossy.f_cos.is_black() {
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

    /// Paths that find the sky behind panes by chance compete with light sampling there. Where such light is known they do not find it.
    pub(super) fn competes_through_panes(&self) -> bool {
        self.settings.knows_openings
            && !self.settings.asks
            && self.left_to_sampling() != LeftToSampling::SunsAndSky
    }

    fn samples_sky_through_panes(&self) -> bool {
        self.competes_through_panes() || self.left_to_sampling() == LeftToSampling::SunsAndSky
    }

    /// What is known of caustics without it.
    fn left_to_sampling(&self) -> LeftToSampling {
        match self.caustics {
            Some(caustics) if self.settings.knows_openings => caustics.leaves(),
            _ => LeftToSampling::Nothing,
        }
    }

    /// By which lobes a surface shows a light from infinitely far that panes let through: what is known of caustics may leave it to light
    /// sampling, and else that competes with paths that find the sky. `None`: by none. Suns that nothing is known of nobody finds, on a card or
    /// here.
    fn shown_through_panes(
        &self,
        path: &Path<'_>,
        surface: &Surface,
        light: &LightSample,
    ) -> Option<ShownFocused> {
        if !self.world.has_glass() || !matches!(light.origin, LightOrigin::Infinite) {
            return None;
        }
        if self.left_to_sampling().holds(light) {
            let shown = self.shows_focused(path, surface)?;
            // As photons are, that are bounded by themselves.
            let of_photons = self.settings.bounces_max.map_or(u32::MAX, |bounces| bounces.saturating_sub(1));
            return Some(ShownFocused { scatterings_max: shown.scatterings_max.min(of_photons), ..shown });
        }
        if light.is_delta || !self.competes_through_panes() {
            return None;
        }
        let [is_diffuse, is_glossy] = [Scatter::Diffuse, Scatter::Specular]
            .map(|scatter| self.settings.traced.contains(path.class.after(scatter).after(Scatter::Specular)));
        let left = |bounces: u32| bounces.checked_sub(path.bounce + 1);
        let scatterings_max = self.settings.bounces_max.map_or(Some(u32::MAX), left)?;
        (is_diffuse || is_glossy).then_some(ShownFocused { is_diffuse, is_glossy, scatterings_max })
    }

    /// Adds that light, as far as panes let it through.
    ///
    /// - `found`: the light, the ray to it, and what would arrive without anything in between
    /// - `shown`: what the surface makes of it, and by which lobes it does
    fn add_through_panes(
        &self,
        path: &Path<'_>,
        found: (&LightSample, &ShadowRay, Rgb),
        (value, shown): (&BsdfValue, ShownFocused),
        sample: &mut PixelSample,
        tally: &mut impl Tally,
    ) {
        let (light, shadow_ray, arriving) = found;
        let Some(passage) = self.world.through_panes(&shadow_ray.ray, |ray| tally.ray(ray)) else { return };
        if passage.boundaries > shown.scatterings_max {
            return;
        }
        let is_alone = self.left_to_sampling().holds(light);
        let mut add = |lobe: &LobeValue, scatter| {
            let weight = if is_alone { 1.0 } else { power_heuristic(light.pdf, lobe.pdf_solid_angle) };
            let class = path.class.after(scatter).after(Scatter::Specular);
            sample.radiance[class as usize] += arriving * passage.share * lobe.f_cos * weight;
        };
        if shown.is_diffuse {
            add(&value.diffuse, Scatter::Diffuse);
        }
        if shown.is_glossy {
            add(&value.glossy, Scatter::Specular);
        }
    }
}
