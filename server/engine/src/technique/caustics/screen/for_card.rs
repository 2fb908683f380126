//! A sketch for a graphics card, which counts its photons in pixels by itself: `technique/path/gpu/sketch.rs`.

#[cfg(all(test, feature = "gpu"))]
mod counted;
#[cfg(all(test, feature = "gpu"))]
mod tests;

use std::sync::{Arc, OnceLock};

use glam::Vec3;

use super::{
    super::upload, CausticSketch, Chosen, FAR_M, SPARSE_SHARE, ScreenCaustics, cell_log2_of, halves_px,
    places_of, weights_of,
};
use crate::{
    technique::{
        FocusedLight, FocusedScatter, LeftToSampling, PackedFocused, PackedSketch, SKETCH_WIDTHS,
        SketchWindows, View,
    },
    transport::Surface,
};

/// Photons of a sketch that a card takes: Mesa's driver on the CPU ends the loops of an invocation after 65,535 rounds, and one cell may
/// have all of them as entries, though each only once. Three times as many as are sent out: more are kept only where light is hardly ever
/// lost.
pub(super) const PHOTONS_MAX: usize = 1 << 15;

impl CausticSketch {
    /// [`CausticSketch::seen_by`] to be found out by a card; `None` where it is more than one takes, or a camera so far away or so wide that
    /// floats may end. Whether the camera sees enough of them only the card knows then.
    pub fn for_card(self: &Arc<CausticSketch>, view: &View) -> Option<Arc<dyn FocusedLight>> {
        let is_taken = self.photons.len() <= PHOTONS_MAX && view.is_within(FAR_M);
        is_taken.then(|| {
            Arc::new(ForCard { sketch: Arc::clone(self), view: *view, on_cpu: OnceLock::new() }) as _
        })
    }
}

/// What a camera sees of a sketch. The CPU finds it out when it is asked after all.
#[derive(Debug)]
struct ForCard {
    sketch: Arc<CausticSketch>,
    view: View,
    on_cpu: OnceLock<ScreenCaustics>,
}

impl ForCard {
    fn on_cpu(&self) -> &ScreenCaustics {
        self.on_cpu
            .get_or_init(|| self.sketch.seen_from(&places_of(&self.sketch.photons, &self.view), &self.view))
    }
}

impl CausticSketch {
    /// Whether it is fit or not; on the one thread that asks: sharing the work out could hand it another's question for the same.
    fn seen_from(&self, places: &[Option<[i32; 2]>], view: &View) -> ScreenCaustics {
        let chosen = Chosen::of(&self.photons, places, view);
        let levels = (0..SKETCH_WIDTHS).map(|width| chosen.level(width, view)).collect();
        ScreenCaustics::of(self, &chosen, levels, view)
    }
}

impl FocusedLight for ForCard {
    fn scattered(&self, surface: &Surface, wo: Vec3, scatterings_max: u32) -> FocusedScatter {
        self.on_cpu().scattered(surface, wo, scatterings_max)
    }

    fn leaves(&self) -> LeftToSampling {
        self.sketch.light.left()
    }

    fn packed(&self) -> Option<PackedFocused> {
        let windows = halves_px(&self.view).map(|half_px| SketchWindows {
            half_px: half_px as u32,
            cell_log2: cell_log2_of(half_px),
            weights: weights_of(half_px),
        });
        let photons = self.sketch.photons.iter().map(upload::packed).collect();
        let (view, sparse_share) = (self.view, SPARSE_SHARE);
        let packed = PackedSketch { photons, view, windows, sparse_share };
        Some(PackedFocused::Sketch(Box::new(packed)))
    }

    fn is_sketch(&self) -> bool {
        true
    }
}
