//! The photons of a pass packed for look-ups on a graphics card, grid by grid.

#[cfg(all(test, feature = "gpu"))]
mod tests;

use rayon::prelude::*;

use super::{CausticMap, CausticPhoton, map::Grid};
use crate::technique::{GpuPhoton, PackedPhotons};

/// The first word of grids.
const GRIDS_AT: usize = 1;
/// Of a grid: both ends of what it covers, the width of a cell, buckets less one, where their starts are.
const GRID_WORDS: usize = 9;

impl CausticMap {
    /// The photons as look-ups on a graphics card read them.
    pub(super) fn pack_photons(&self) -> PackedPhotons {
        let grid_count = self.grids.len();
        let mut words = vec![grid_count as u32];
        words.resize(GRIDS_AT + GRID_WORDS * grid_count, 0);
        let mut photons = Vec::with_capacity(self.grids.iter().map(|grid| grid.photons.len()).sum());
        for (number, grid) in self.grids.iter().enumerate() {
            let Grid { cell_m, min, max, starts, entries, .. } = grid;
            let starts_at = words.len() as u32;
            let ends = [min.to_array(), max.to_array()].concat();
            let mut header: Vec<u32> = ends.into_iter().chain([*cell_m]).map(f32::to_bits).collect();
            header.extend([starts.len() as u32 - 2, starts_at]);
            words[GRIDS_AT + GRID_WORDS * number..][..GRID_WORDS].copy_from_slice(&header);
            let entries_at = starts_at + starts.len() as u32;
            words.extend(starts.iter().map(|start| entries_at + start));
            let first_photon = photons.len() as u32;
            words.extend(entries.iter().map(|photon| first_photon + photon));
            photons.par_extend(grid.photons.par_iter().map(packed));
        }
        PackedPhotons { photons, words }
    }
}

pub(super) fn packed(photon: &CausticPhoton) -> GpuPhoton {
    GpuPhoton {
        position: photon.position.into(),
        r2: photon.radius_m * photon.radius_m,
        flux_w: photon.flux_w.to_array(),
        scatterings: photon.scatterings.into(),
        direction: photon.direction.into(),
        padding_0: 0,
        normal: photon.normal.into(),
        padding_1: 0,
    }
}
