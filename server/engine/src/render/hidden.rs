//! Light that path tracing cannot find: from lights without size by way of mirrors and clear glass. Where a scene has any,
//! photons bring it to path-traced pictures as well, so that these are of the same light as those that are looked up.

use std::sync::{Arc, atomic::AtomicBool};

use crate::{
    effects::EffectPlan,
    film::PictureSize,
    technique::{
        Counts, FocusedLight, Products, Step, Technique,
        caustics::{CausticLight, CausticReport, CausticSettings, Caustics},
    },
    transport::World,
};

use super::RenderSettings;

/// Caustics of hidden light alone, with numbers of their own.
#[derive(Debug)]
pub(super) struct HiddenLight {
    caustics: Caustics,
    /// Of the last two passes: they are independent.
    maps: [Option<Arc<dyn FocusedLight>>; 2],
    passes: usize,
}

impl HiddenLight {
    /// `None` where the scene has none.
    pub(super) fn of(plan: &EffectPlan, settings: &RenderSettings, size: PictureSize) -> Option<HiddenLight> {
        // Numbers of its own: what path tracing measures must not share them.
        let seed = settings.seed ^ 0x6869_6464_656e_0000;
        let of = CausticSettings::of(size.pixel_count(), settings.bounces_max, seed);
        let caustics = Caustics::new(CausticSettings { light: CausticLight::Hidden, ..of });
        plan.facts.hides_light().then_some(HiddenLight { caustics, maps: [None, None], passes: 0 })
    }

    /// Makes the map of the next pass, in place of the last but one.
    pub(super) fn renew(&mut self, world: &World, cancel: &AtomicBool) -> Counts {
        let mut products = Products::default();
        let counts =
            self.caustics.step(&mut Step { world, products: &mut products, canvas: None, cancel }).counts;
        self.maps[self.passes & 1] = products.caustics;
        self.passes += 1;
        counts
    }

    /// What it took and holds.
    pub(super) fn report(&self) -> CausticReport {
        self.caustics.report()
    }

    /// The last two maps.
    pub(super) fn maps(&self) -> [Option<&dyn FocusedLight>; 2] {
        [self.maps[0].as_deref(), self.maps[1].as_deref()]
    }

    /// The last map, for a picture that is path-traced.
    pub(super) fn products(&self) -> Products {
        let last = self.passes.wrapping_sub(1) & 1;
        Products { caustics: self.maps[last].clone(), ..Products::default() }
    }
}
