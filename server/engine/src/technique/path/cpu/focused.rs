//! Light that only mirrors and glass sent on before it falls on a surface, where that is known: looked up, and sampled as far as panes let
//! light from infinitely far through.

use super::{Path, Tracer, light::power_heuristic};
use crate::{
    film::PixelSample,
    math::Rgb,
    technique::{LeftToSampling, path::Tally},
    transport::{
        BsdfValue, LightOrigin, LightSample, PathClass, Scatter, ShadowRay, Surface, bsdf::LobeValue,
    },
};

/// Glosses that show such light.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Glosses {
    /// [Broad](crate::transport::Bsdf::has_broad_gloss) ones.
    Broad,
    /// All that have a width.
    Any,
}

/// By which of its lobes a surface shows light that only mirrors and glass sent on before.
#[derive(Clone, Copy)]
pub(super) struct ShownFocused {
    is_diffuse: bool,
    is_glossy: bool,
    /// Scatterings before, at most.
    scatterings_max: u32,
}

impl Tracer<'_> {
    /// Adds what the surface sends to the eye of light that only mirrors and glass sent on before, by its diffuse lobe and by
    /// a broad gloss. True if that gloss has all of it: what is gathered by way of further mirrors would be part of it.
    pub(super) fn gather_focused(
        &self,
        path: &Path<'_>,
        surface: &Surface,
        sample: &mut PixelSample,
    ) -> bool {
        let Some(caustics) = self.caustics else { return false };
        let Some(shown) = self.shows_focused(path, surface, Glosses::Broad) else { return false };
        let focused = caustics.scattered(surface, -path.ray.direction, shown.scatterings_max);
        let mut add = |scatter, radiance| {
            let class = path.class.after(scatter).after(Scatter::Specular);
            sample.radiance[class as usize] += path.throughput * radiance;
        };
        if shown.is_diffuse {
            add(Scatter::Diffuse, focused.diffuse);
        }
        if shown.is_glossy {
            add(Scatter::Specular, focused.glossy);
        }
        shown.is_glossy
    }

    /// By which lobes a surface shows the path light that only mirrors and glass sent on before, where paths do not find that: the diffuse
    /// one, and `glosses`. `None`: by none.
    fn shows_focused(&self, path: &Path<'_>, surface: &Surface, glosses: Glosses) -> Option<ShownFocused> {
        // A gloss shows the light of lamps in mirrors, which goes with the caustics.
        let is_shown = self.settings.shown.contains(PathClass::Caustic);
        // What a gloss before has gathered is not sampled again, unless photons stop where light can be sampled.
        let is_left = path.since_gathered == 0 || glosses == Glosses::Any && !self.settings.asks;
        let is_glossy = (is_shown || path.class == PathClass::Indirect)
            && (glosses == Glosses::Any || surface.bsdf.has_broad_gloss())
            && is_left
            // What it sends to a near surface before is known there.
            && !path.is_beyond_near();
        // From surfaces that are seen, nothing else.
        let is_diffuse = surface.bsdf.has_diffuse() && (is_shown || path.class.meets_diffuse());
        if !(is_glossy || is_diffuse) || !self.asks_for_more(path) {
            return None;
        }
        // What is looked up is bounded by itself, whatever lies between the surface and the eye.
        let scatterings_max = match self.settings.bounces_max.filter(|_| !self.settings.asks) {
            Some(bounces) => bounces - path.bounce - 1,
            None => u32::MAX,
        };
        Some(ShownFocused { is_diffuse, is_glossy, scatterings_max })
    }

    /// So many scatterings ago or more, by mirrors alone since, a gloss gathered all the light that lights send by mirrors.
    pub(super) fn has_gathered(&self, path: &Path<'_>, scatterings: u32) -> bool {
        self.settings.asks && path.since_gathered >= scatterings
    }

    /// Paths that find the sky behind panes by chance compete with light sampling there. Where such light is known they do not find it.
    pub(super) fn competes_through_panes(&self) -> bool {
        self.settings.knows_openings
            && !self.settings.asks
            && self.left_to_sampling() != LeftToSampling::SunsAndSky
    }

    pub(super) fn samples_sky_through_panes(&self) -> bool {
        self.competes_through_panes() || self.left_to_sampling() == LeftToSampling::SunsAndSky
    }

    /// Light through panes that is for light sampling alone to find.
    fn left_to_sampling(&self) -> LeftToSampling {
        self.settings.left_to_sampling(self.caustics)
    }

    /// By which lobes a surface shows a light from infinitely far that panes let through: it may be left to light sampling, and else that
    /// competes with paths that find the sky. `None`: by none.
    pub(super) fn shown_through_panes(
        &self,
        path: &Path<'_>,
        surface: &Surface,
        light: &LightSample,
    ) -> Option<ShownFocused> {
        if !self.world.has_glass() || !matches!(light.origin, LightOrigin::Infinite) {
            return None;
        }
        if self.left_to_sampling().holds(light) {
            // A narrow gloss finds the sky by where it sends paths, and no sun.
            let glosses = if light.is_delta { Glosses::Any } else { Glosses::Broad };
            let shown = self.shows_focused(path, surface, glosses)?;
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
    pub(super) fn add_through_panes(
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
