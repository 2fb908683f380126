//! Light that path tracing cannot find: from lights without size by way of mirrors and clear glass, but for suns straight through panes. Where a scene has any,
//! photons bring it to path-traced pictures as well, so that these are of the same light as those that are looked up.
//!
//! **Consistent**, like the caustics that are looked up: what is measured against such path tracing does not show by how much
//! hidden light is blurred.

use std::sync::{Arc, atomic::AtomicBool};

use crate::{
    film::PictureSize,
    math::sobol,
    technique::{
        FocusedLight, Products, Progress,
        caustics::{CausticLight, CausticReport, CausticSettings, Caustics},
        path::View,
    },
    transport::World,
};

use super::RenderSettings;

/// So many times fewer photons than a picture has are for the measure of its error, at most.
const MEASURE_FEWER: u32 = 16;

/// What hidden light is for: each has photons of its own, so that what is compared is independent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum HiddenFor {
    /// The film that is looked up, as long as nothing is known to look up.
    LookedUp,
    /// The path-traced film beside it.
    Traced,
    /// The measure of the error.
    Measure,
}

/// Caustics of hidden light alone.
#[derive(Debug)]
pub(super) struct HiddenLight {
    caustics: Caustics,
}

impl HiddenLight {
    /// No map yet.
    pub(super) fn new(
        settings: &RenderSettings,
        (view, size): (View, PictureSize),
        what_for: HiddenFor,
    ) -> HiddenLight {
        let seed = sobol::mix(settings.seed ^ (0x6869_6464_656e_0000 + what_for as u64));
        let of = CausticSettings::of(size.pixel_count(), settings.bounces_max, seed);
        let photons_max = match what_for {
            // It has a twentieth of the time, and is to know the first two maps soon.
            HiddenFor::Measure => of.photons_max / MEASURE_FEWER,
            HiddenFor::LookedUp | HiddenFor::Traced => of.photons_max,
        };
        let caustics = Caustics::new(CausticSettings {
            photons_max,
            light: CausticLight::Hidden,
            seen_by: Some(view),
            passes_by_flux: u32::from(what_for == HiddenFor::LookedUp && settings.is_watched()),
            ..of
        });
        HiddenLight { caustics }
    }

    /// Makes the map of a pass, unless it is there.
    pub(super) fn prepare(&mut self, world: &World, pass: u32, cancel: &AtomicBool) -> Progress {
        self.caustics.prepare(world, pass, cancel)
    }

    /// That map.
    pub(super) fn products(&self) -> Products {
        Products { caustics: self.caustics.map(), ..Products::default() }
    }

    /// What it took and holds.
    pub(super) fn report(&self) -> CausticReport {
        self.caustics.report()
    }
}

/// Hidden light for the two halves of a measure, renewed now and then.
#[derive(Debug)]
pub(super) struct HiddenHalves {
    light: HiddenLight,
    maps: [Option<Arc<dyn FocusedLight>>; 2],
    /// Maps made so far.
    passes: u32,
    /// Rays of the last one, and of what was measured with it.
    map_rays: u64,
    measured_rays: u64,
}

impl HiddenHalves {
    pub(super) fn new(light: HiddenLight) -> HiddenHalves {
        HiddenHalves { light, maps: [None, None], passes: 0, map_rays: 0, measured_rays: 0 }
    }

    /// Another map is to be made before anything is measured: at first one for each half, later as often as that takes no more
    /// than measuring.
    pub(super) fn is_due(&self) -> bool {
        self.passes < 2 || self.measured_rays > self.map_rays
    }

    /// Makes the next map, in place of the last but one; goes on with it where it was cut short.
    pub(super) fn renew(&mut self, world: &World, cancel: &AtomicBool) -> Progress {
        let progress = self.light.prepare(world, self.passes, cancel);
        self.map_rays = if self.measured_rays > 0 { 0 } else { self.map_rays } + progress.counts.all_rays();
        self.measured_rays = 0;
        if progress.complete {
            self.maps[(self.passes & 1) as usize] = self.light.products().caustics;
            self.passes += 1;
        }
        progress
    }

    /// So many rays were traced with what is there.
    pub(super) fn measured(&mut self, rays: u64) {
        self.measured_rays += rays;
    }

    pub(super) fn maps(&self) -> [Option<&dyn FocusedLight>; 2] {
        [self.maps[0].as_deref(), self.maps[1].as_deref()]
    }

    pub(super) fn report(&self) -> CausticReport {
        self.light.report()
    }
}
