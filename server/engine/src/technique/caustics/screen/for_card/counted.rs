//! What the CPU counts of a sketch, for tests of what a card does.

use std::sync::Arc;

use super::{super::near, *};
use crate::technique::{
    SHOWN_NOWHERE,
    caustics::{CausticLight, CausticPhoton, CausticReport, screen},
};

/// A sketch in the pixels of a picture.
#[derive(Debug)]
pub(crate) struct Counted {
    /// By photon, as [`PackedSketch::is_fit`] takes it.
    pub(crate) chosen: Vec<u32>,
    pub(crate) is_fit: bool,
    /// Photons by width and cell.
    pub(crate) cells: Vec<Vec<Vec<u32>>>,
}

impl CausticSketch {
    /// Of photons that were followed by nobody.
    pub(crate) fn of_photons(photons: Vec<CausticPhoton>) -> CausticSketch {
        let (light, report) = (CausticLight::All, CausticReport::default());
        CausticSketch { photons: near(photons).into(), light, report, rays: 0 }
    }

    pub(crate) fn photons(&self) -> &[CausticPhoton] {
        &self.photons
    }

    /// The pixel of each photon.
    pub(crate) fn places(&self, view: &View) -> Vec<Option<[i32; 2]>> {
        places_of(&self.photons, view)
    }

    /// What they come to if they are in these pixels.
    pub(crate) fn counted(&self, places: &[Option<[i32; 2]>], view: &View) -> Counted {
        let halves_px = halves_px(view);
        let margin = screen::margin_of(halves_px);
        let counts = screen::Counts::of(places.iter().flatten(), screen::extent_of(view), margin);
        let width_of = |pixel: [i32; 2]| counts.level_of(pixel, halves_px).unwrap_or(SKETCH_WIDTHS) as u32;
        let chosen = places.iter().map(|place| place.map_or(SHOWN_NOWHERE, width_of)).collect();
        let in_cell = |placed: &[screen::Placed]| placed.iter().map(|placed| placed.photon).collect();
        let cells_of = |level: &screen::Level| {
            let ends = level.starts[..level.starts.len() - 1].windows(2);
            ends.map(|ends| in_cell(&level.placed[ends[0] as usize..ends[1] as usize])).collect()
        };
        let cells = self.seen_from(places, view).levels.iter().map(cells_of).collect();
        Counted { chosen, is_fit: Chosen::of(&self.photons, places, view).is_fit, cells }
    }

    /// What is seen of them if they are in these pixels.
    pub(crate) fn seen_in(&self, places: &[Option<[i32; 2]>], view: &View) -> Arc<dyn FocusedLight> {
        Arc::new(self.seen_from(places, view))
    }
}
