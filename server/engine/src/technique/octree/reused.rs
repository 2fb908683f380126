//! Light that an octree takes over from the one before an edit.

use std::{cmp::Ordering, collections::HashMap, sync::Arc};

use glam::Vec3;

use super::{
    LightOctree,
    build::{Building, SetLight},
    cluster::Spread,
    voxels::VoxelSet,
};
use crate::technique::{ChangedPhotons, MAPPED, SideId};

/// The octree before an edit, and where its light is out of date.
#[derive(Debug)]
pub(super) struct Reused {
    pub(super) octree: Arc<LightOctree>,
    /// For every side of its surfaces, the same side now.
    pub(super) sides: Vec<Option<SideId>>,
    pub(super) changed: Changed,
    /// Boxes around what came, went or moved, which may be or have been a wall; render space.
    pub(super) moved: Vec<[Vec3; 2]>,
}

impl Reused {
    /// Something came or went that near.
    fn is_moved_within(&self, radius_m: f32, middle: Vec3) -> bool {
        self.moved.iter().any(|[low, high]| {
            middle.distance_squared(middle.clamp(*low, *high)) <= radius_m * radius_m * (1.0 + 1e-5)
        })
    }
}

/// Where photons came or went, for asking how near.
pub(super) struct Changed {
    /// By class and side.
    trees: [HashMap<SideId, kiddo::ImmutableKdTree<f32, 3>>; 2],
}

impl std::fmt::Debug for Changed {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Changed").field("sides", &self.trees[0].len()).finish()
    }
}

impl Changed {
    pub(super) fn of(changed: &ChangedPhotons) -> Changed {
        let tree_of = |places: &Vec<Vec3>| {
            let mut places: Vec<[f32; 3]> = places.iter().map(Vec3::to_array).collect();
            // Photons that changed colour only came and went at one place.
            places.sort_unstable_by(|a, b| a.partial_cmp(b).unwrap_or(Ordering::Equal));
            places.dedup();
            kiddo::ImmutableKdTree::new_from_slice(&places).ok()
        };
        let trees = [0, 1].map(|class: usize| {
            changed[class].iter().filter_map(|(side, places)| Some((*side, tree_of(places)?))).collect()
        });
        Changed { trees }
    }

    /// True when a photon of the class came or went on one of the sides within the radius.
    fn is_within(&self, class: usize, sides: &[SideId], radius_m: f32, centre: Vec3) -> bool {
        sides.iter().filter_map(|side| self.trees[class].get(side)).any(|tree| {
            let centre = centre.to_array();
            let nearest = tree.query(&centre).nearest_one::<kiddo::SquaredEuclidean<f32>>().execute();
            nearest.distance <= radius_m * radius_m * (1.0 + 1e-5)
        })
    }
}

impl Building {
    /// The light of the cell before, if neither its surfaces nor any photon near them changed.
    pub(super) fn kept_of_cell(&self, cell: usize, sets: &[VoxelSet]) -> Option<Vec<SetLight>> {
        let reused = self.reused.as_ref()?;
        let octree = &reused.octree;
        let old_cell = octree.voxels.codes.binary_search(&self.voxels.codes[cell]).ok()?;
        let first = octree.voxels.first_set[old_cell] as usize;
        let old_sets = octree.voxels.sets_of(old_cell);
        if old_sets.len() != sets.len() {
            return None;
        }
        let same_sides = |old: &VoxelSet, new: &VoxelSet| {
            let old = octree.voxels.sides_of(old).iter().map(|side| reused.sides[side.index()]);
            old.eq(self.voxels.sides_of(new).iter().map(|side| Some(*side)))
        };
        let is_kept = |(place, (old, new)): (usize, (&VoxelSet, &VoxelSet))| {
            let light = &octree.gathers[first + place];
            (old.normal, old.centre, old.area_m2) == (new.normal, new.centre, new.area_m2)
                && old.is_alone == new.is_alone
                && same_sides(old, new)
                && !reused.is_moved_within(self.gathers().look_m(new), new.centre)
                && !(0..MAPPED.len()).any(|class| {
                    let sides = self.voxels.sides_of(new);
                    reused.changed.is_within(class, sides, light.reach_m[class], new.centre)
                })
        };
        old_sets
            .iter()
            .zip(sets)
            .enumerate()
            .all(is_kept)
            .then(|| (first..first + sets.len()).map(|set| octree.light_of_set(set)).collect())
    }
}

impl LightOctree {
    fn light_of_set(&self, set: usize) -> SetLight {
        let (leaf, gather) = (&self.sets[set], &self.gathers[set]);
        SetLight {
            vdls: [0, 1].map(|class| self.vdls_of(leaf, class).to_vec()),
            harmonics: self.harmonics.get(set).copied(),
            radius_m: gather.radius_m,
            reach_m: gather.reach_m,
            spread: [0, 1].map(|class| Spread {
                chord_rms: gather.chord_rms[class],
                rise: gather.rise[class],
                ..Spread::default()
            }),
            is_alone: leaf.is_alone,
            walls: gather.walls.map(|place| self.walls[place as usize]),
        }
    }
}
