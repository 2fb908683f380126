//! Records packed for look-ups on a graphics card: those of every cache by themselves, and tables of the cells that they are entered in.

#[cfg(test)]
mod tests;

use glam::IVec3;
use rayon::prelude::*;

use super::{
    IrradianceCache, Record, Weighing,
    index::{Index, per_cell},
};
use crate::technique::{GpuRecord, PackedRecords};

/// Flags in the second word: something answers where no record counts, and knows caustics.
const HAS_BASE: u32 = 1;
const HAS_CAUSTICS: u32 = 2;
/// The first word of caches.
const CACHES_AT: usize = 2;
/// Of a cache.
const CACHE_WORDS: usize = 6;
/// Of a cell.
const CELL_WORDS: usize = 6;
/// Places of a table for each cell, at least: with as many empty ones as full ones a search ends after two or three.
const PLACES_PER_CELL: usize = 2;
/// Records reach as far as this at least, m: cards divide by it.
const REACH_MIN_M: f32 = 1e-30;

impl IrradianceCache {
    /// The records as look-ups on a graphics card read them.
    pub(super) fn pack_records(&self) -> PackedRecords {
        let caches: Vec<&IrradianceCache> =
            std::iter::successors(Some(self), |cache| cache.rougher.as_deref()).collect();
        let has_base = if self.base.is_some() { HAS_BASE } else { 0 };
        let has_caustics =
            if self.base.as_ref().is_some_and(|base| base.has_caustics()) { HAS_CAUSTICS } else { 0 };
        let mut words = vec![caches.len() as u32, has_base | has_caustics];
        words.resize(CACHES_AT + CACHE_WORDS * caches.len(), 0);
        let counts: Vec<u32> = caches.iter().map(|cache| cache.records.len() as u32).collect();
        let mut records = Vec::with_capacity(counts.iter().sum::<u32>() as usize);
        for (number, cache) in caches.into_iter().enumerate() {
            let weighing = &cache.settings.weighing;
            let [levels_at, levels_end, table_at, table_mask] =
                lay_out(&cache.index, records.len() as u32, &mut words);
            let header = [
                weighing.accuracy.to_bits(),
                u32::from(weighing.is_smooth),
                levels_at,
                levels_end,
                table_at,
                table_mask,
            ];
            words[CACHES_AT + CACHE_WORDS * number..][..CACHE_WORDS].copy_from_slice(&header);
            records.par_extend(cache.records.par_iter().map(|record| packed(record, weighing)));
        }
        PackedRecords { records, counts, words }
    }
}

/// Adds the words of an index: its levels, what its cells name, and their table. Returns the first and the end of levels, the first of
/// the table, and its places less one.
///
/// - `first_record`: of the cache among all
fn lay_out(index: &Index, first_record: u32, words: &mut Vec<u32>) -> [u32; 4] {
    let levels_at = words.len() as u32;
    words.extend(index.levels().iter().flat_map(|level| [*level as u32, per_cell(*level).to_bits()]));
    let levels_end = words.len() as u32;
    let mut cells: Vec<_> = index.cells().collect();
    // In an order that does not depend on the map.
    cells.par_sort_unstable_by_key(|(level, at, _)| (*level, at.to_array()));
    let place_count = (PLACES_PER_CELL * cells.len()).next_power_of_two().max(PLACES_PER_CELL);
    let mut table = vec![[0; CELL_WORDS]; place_count];
    for (level, at, entered) in cells {
        let mut place = hash_of_cell(level, at) as usize % place_count;
        while table[place][CELL_WORDS - 1] > 0 {
            place = (place + 1) % place_count;
        }
        let [x, y, z] = at.to_array().map(|at| at as u32);
        table[place] = [level as u32, x, y, z, words.len() as u32, entered.len() as u32];
        words.extend(entered.iter().map(|record| first_record + record));
    }
    let table_at = words.len() as u32;
    words.extend_from_slice(table.as_flattened());
    [levels_at, levels_end, table_at, place_count as u32 - 1]
}

/// Twin of that in `shaders/irradiance/look_up.wgsl`.
fn hash_of_cell(level: i32, at: IVec3) -> u32 {
    let mix = |hash: u32, at: i32| {
        let hash = (hash ^ at as u32).wrapping_mul(0x85eb_ca6b);
        hash ^ hash >> 15
    };
    at.to_array().into_iter().fold((level as u32).wrapping_mul(0x9e37_79b1), mix)
}

fn packed(record: &Record, weighing: &Weighing) -> GpuRecord {
    let gradient = |gradient: super::Gradient| {
        gradient.map(|change| if weighing.has_gradients { change.to_array() } else { [0.0; 3] })
    };
    let [turning_red, turning_green, turning_blue] = gradient(record.turning);
    let [moving_red, moving_green, moving_blue] = gradient(record.moving);
    let [[ways_0, ways_1, ways_2], [rises_0, rises_1, rises_2]] = record.horizon.words();
    GpuRecord {
        position: record.position.into(),
        reach_m: record.reach_m(weighing.accuracy).max(REACH_MIN_M),
        normal: record.normal.into(),
        way_share: record.way_share(weighing.accuracy),
        n_geo: record.n_geo.into(),
        // Cards may assume that nothing is infinite.
        nearest_m: record.horizon.nearest_m().min(f32::MAX),
        irradiance: record.irradiance.to_array(),
        coat_rise: record.coat_rise(),
        turning_red,
        ways_0,
        turning_green,
        ways_1,
        turning_blue,
        ways_2,
        moving_red,
        rises_0,
        moving_green,
        rises_1,
        moving_blue,
        rises_2,
    }
}
