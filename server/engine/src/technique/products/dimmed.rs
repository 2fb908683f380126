//! What is known of the light of a scene whose lights have all become brighter, darker or of another colour alike since then.

use std::sync::Arc;

use glam::{UVec2, Vec3};

use super::{Card, FirstSight, Guide, LitFrom, ScatteredLight, ScreenLight, SecondaryLight, View};
use crate::{math::Rgb, transport::Surface};

/// Light times the same everywhere, channel by channel: exact, since light is linear in its sources. For the moment until it is known of the
/// scene as it is.
#[derive(Debug)]
pub struct Dimmed {
    light: Arc<dyn SecondaryLight>,
    by: Rgb,
}

impl Dimmed {
    /// Some light times `by`, finite and not negative.
    pub fn by(by: Rgb, light: Arc<dyn SecondaryLight>) -> Arc<dyn SecondaryLight> {
        let (light, by) = match light.undimmed() {
            Some((undimmed, before)) => (Arc::clone(undimmed), before * by),
            None => (light, by),
        };
        if by == Rgb::WHITE { light } else { Arc::new(Dimmed { light, by }) }
    }

    fn dim(&self, known: ScatteredLight) -> ScatteredLight {
        ScatteredLight {
            indirect: known.indirect * self.by,
            caustic: known.caustic * self.by,
            from: known.from.map(|from| LitFrom { share: from.share * self.by, ..from }),
            ..known
        }
    }
}

impl SecondaryLight for Dimmed {
    fn card(&self) -> &'static Card {
        self.light.card()
    }

    fn scattered(&self, surface: &Surface, wo: Vec3, draw: Option<[f32; 3]>) -> ScatteredLight {
        self.dim(self.light.scattered(surface, wo, draw))
    }

    fn scattered_but_caustics(&self, surface: &Surface, wo: Vec3, draw: Option<[f32; 3]>) -> ScatteredLight {
        self.dim(self.light.scattered_but_caustics(surface, wo, draw))
    }

    fn even_irradiance(&self, p: Vec3, n_geo: Vec3, n: Vec3) -> Option<Rgb> {
        Some(self.light.even_irradiance(p, n_geo, n)? * self.by)
    }

    fn laid_out_for(self: Arc<Self>, view: &View) -> Option<Arc<dyn ScreenLight>> {
        let screen = Arc::clone(&self.light).laid_out_for(view)?;
        Some(Arc::new(DimmedScreen { screen, by: self.by }))
    }

    fn undimmed(&self) -> Option<(&Arc<dyn SecondaryLight>, Rgb)> {
        Some((&self.light, self.by))
    }

    fn places(&self) -> Vec<Vec3> {
        self.light.places()
    }

    fn guide(&self) -> Option<&Guide> {
        self.light.guide()
    }

    fn has_caustics(&self) -> bool {
        self.light.has_caustics()
    }

    fn noise(&self) -> f64 {
        self.light.noise()
    }

    fn has_records(&self) -> bool {
        self.light.has_records()
    }
}

/// The same laid out over a picture.
#[derive(Debug)]
struct DimmedScreen {
    screen: Arc<dyn ScreenLight>,
    by: Rgb,
}

impl ScreenLight for DimmedScreen {
    fn scattered_over(&self, origin: UVec2, size: UVec2, seen: &[Option<FirstSight>]) -> Vec<Option<Rgb>> {
        let mut scattered = self.screen.scattered_over(origin, size, seen);
        scattered.iter_mut().flatten().for_each(|light| *light *= self.by);
        scattered
    }

    fn thread_seconds(&self) -> f64 {
        self.screen.thread_seconds()
    }
}
