//! What the groups of an octree gather: where, how far, and before which walls.

#[cfg(feature = "gpu")]
use rayon::prelude::*;

#[cfg(feature = "gpu")]
use super::LightOctree;
use super::{
    OctreeSettings,
    voxels::{VoxelSet, Voxels},
};
#[cfg(feature = "gpu")]
use crate::technique::SideId;
use crate::{
    math::sobol::mix,
    technique::{GatherBounds, WallSearch, Walls},
    transport::World,
};

/// What stands up less from a surface is no wall, in sides of a cell.
pub(super) const LIFT_CELLS: f32 = 0.25;
/// Walls are looked for at least so far, in sides of a cell: from the middle of a cell to its corners, and half a blur on.
pub(super) const LOOK_CELLS: f32 = 1.5;

/// The number of a group, by its cell and its place there.
pub(super) fn key_of(code: u32, place: u64) -> u64 {
    mix(u64::from(code) << 8 | place)
}

/// How the groups of an octree gather.
#[derive(Clone, Copy, Debug)]
pub(super) struct Gathers<'a> {
    pub(super) voxels: &'a Voxels,
    pub(super) settings: &'a OctreeSettings,
    /// Where cells are all as large.
    pub(super) radius_max_m: f32,
}

impl Gathers<'_> {
    /// How far a group looks around itself for walls: as far as its gather may reach, or look-ups near it.
    pub(super) fn look_m(&self, set: &VoxelSet) -> f32 {
        let cell_m = self.voxels.cube.cell_m();
        self.radius_max_m.max(LOOK_CELLS * cell_m) * set.scale + LIFT_CELLS * set.across_m
    }

    fn search_around(&self, set: &VoxelSet, key: u64) -> WallSearch {
        let lift_m = LIFT_CELLS * set.across_m;
        WallSearch {
            middle: set.centre,
            normal: set.normal,
            lift_m,
            radius_m: self.look_m(set) - lift_m,
            turn: mix(key) as u32 as f32 / u32::MAX as f32,
        }
    }

    /// Where and how far one gathers.
    ///
    /// - `key`: as [`key_of`] has it
    pub(super) fn bounds_of(&self, world: &World, set: &VoxelSet, key: u64) -> GatherBounds {
        GatherBounds {
            centre: set.centre,
            normal: set.normal,
            radius_m: self.settings.radius_cells * self.voxels.cube.cell_m() * set.scale,
            count_min: self.settings.neighbours_min,
            count_max: self.settings.neighbours_max,
            radius_max_m: self.radius_max_m * set.scale,
            count_narrow: self.settings.neighbours_narrow,
            walls: Walls::around(world.accel(), &self.search_around(set, key)),
        }
    }
}

/// What one group of an octree gathered.
#[cfg(feature = "gpu")]
#[derive(Clone, Debug)]
pub struct OctreeGather {
    /// The sides of surfaces of the group, ascending.
    pub sides: Vec<SideId>,
    /// Where and how far.
    pub bounds: GatherBounds,
}

#[cfg(feature = "gpu")]
impl LightOctree {
    /// What all groups gathered, cell by cell.
    ///
    /// - `world`: of the scene that it was built of
    pub fn gathers(&self, world: &World) -> Vec<OctreeGather> {
        let gathers =
            Gathers { voxels: &self.voxels, settings: &self.settings, radius_max_m: self.radius_max_m };
        let of_cell = |cell: usize| {
            let code = self.voxels.codes[cell];
            let of_set = move |(place, set): (u64, &VoxelSet)| OctreeGather {
                sides: self.voxels.sides_of(set).to_vec(),
                bounds: gathers.bounds_of(world, set, key_of(code, place)),
            };
            (0u64..).zip(self.voxels.sets_of(cell)).map(of_set).collect::<Vec<_>>()
        };
        (0..self.voxels.codes.len()).into_par_iter().flat_map_iter(of_cell).collect()
    }
}
