//! Records by place: which of them may count at a point.
//!
//! A record is entered in the cells that its sphere meets, in a grid as coarse as that sphere; there is a grid for every
//! power of two. A look-up asks one cell of each.

use std::{
    collections::HashMap,
    hash::{BuildHasherDefault, Hasher},
};

use glam::{IVec3, Vec3};

use crate::math::sobol::mix;

/// A cell of one of the grids.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Cell {
    level: i32,
    at: IVec3,
}

/// Mixes the four numbers of a cell.
#[derive(Clone, Debug, Default)]
struct CellHasher(u64);

impl Hasher for CellHasher {
    fn finish(&self) -> u64 {
        self.0
    }

    fn write(&mut self, bytes: &[u8]) {
        bytes.iter().for_each(|byte| self.0 = mix(self.0 ^ u64::from(*byte)));
    }

    fn write_i32(&mut self, number: i32) {
        self.0 = mix(self.0.rotate_left(7) ^ u64::from(number as u32));
    }
}

/// See the module's head.
#[derive(Clone, Debug, Default)]
pub(super) struct Index {
    cells: HashMap<Cell, Vec<u32>, BuildHasherDefault<CellHasher>>,
    /// Levels in use, ascending.
    levels: Vec<i32>,
    entries: usize,
}

/// Spheres that are larger than any scene are not entered.
const REACH_MAX_M: f32 = 1e15;
/// Levels beyond are those of lengths that no scene has.
const LEVEL_RANGE: (i32, i32) = (-60, 60);

impl Index {
    /// Enters a record with its sphere.
    pub(super) fn insert(&mut self, record: u32, centre: Vec3, reach_m: f32) {
        if !(centre.is_finite() && reach_m < REACH_MAX_M) {
            return;
        }
        let level = (2.0 * reach_m).log2().ceil().clamp(LEVEL_RANGE.0 as f32, LEVEL_RANGE.1 as f32) as i32;
        let (low, high) = (cell(centre - reach_m, level), cell(centre + reach_m, level));
        for x in low.x..=high.x {
            for y in low.y..=high.y {
                for z in low.z..=high.z {
                    let cell = Cell { level, at: IVec3::new(x, y, z) };
                    self.cells.entry(cell).or_default().push(record);
                    self.entries += 1;
                }
            }
        }
        if let Err(place) = self.levels.binary_search(&level) {
            self.levels.insert(place, level);
        }
    }

    /// The records whose spheres may hold `p`.
    #[inline]
    pub(super) fn around(&self, p: Vec3) -> impl Iterator<Item = u32> {
        self.levels
            .iter()
            .filter_map(move |level| self.cells.get(&Cell { level: *level, at: cell(p, *level) }))
            .flatten()
            .copied()
    }

    /// Levels in use, ascending.
    pub(super) fn levels(&self) -> &[i32] {
        &self.levels
    }

    /// Cells with their levels and what is entered in each, in no order.
    pub(super) fn cells(&self) -> impl Iterator<Item = (i32, IVec3, &[u32])> {
        self.cells.iter().map(|(Cell { level, at }, records)| (*level, *at, &records[..]))
    }

    /// Memory.
    pub(super) fn bytes(&self) -> usize {
        self.entries * size_of::<u32>() + self.cells.len() * (size_of::<Cell>() + size_of::<Vec<u32>>() + 8)
    }
}

/// One over the width of a level's cells, 1/m.
pub(super) fn per_cell(level: i32) -> f32 {
    (-level as f32).exp2()
}

fn cell(p: Vec3, level: i32) -> IVec3 {
    // Far outside is as good as outside.
    (p * per_cell(level)).floor().clamp(Vec3::splat(-1e9), Vec3::splat(1e9)).as_ivec3()
}
