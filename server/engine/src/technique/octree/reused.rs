//! Light that an octree takes over from the one before an edit.
//!
//! Of the groups that a small edit touches at all most lose or win a photon or two of a hundred. What gets much other light is gathered first, and
//! an octree shown that owes the rest; then that is gathered, which leaves what a fresh build would.

use std::{cmp::Ordering, collections::HashMap, sync::Arc};

use glam::Vec3;

use super::{
    LightOctree,
    build::{Building, SetLight},
    cluster::Spread,
    voxels::VoxelSet,
};
use crate::technique::{ChangedPhotons, MAPPED, PhotonProduct, SideId};

/// A group may owe its light for a while, if no more photons than this share of it came or went: of the number, whatever they carry, which
/// is up to four times as much where a light's photons are thinned out.
const OWED_SHARE: f32 = 1.0 / 12.0;

/// The octree before an edit, and where its light is out of date.
#[derive(Debug)]
pub(super) struct Reused {
    octree: Arc<LightOctree>,
    /// For every side of its surfaces, the same side now.
    sides: Vec<Option<SideId>>,
    /// Where photons came or went since.
    changed: Changed,
    /// Share of the photons of a group that may be owed.
    owed_share: f32,
    /// Boxes around what came, went or moved, which may be or have been a wall; render space.
    moved: Vec<[Vec3; 2]>,
}

impl Reused {
    /// What an octree in as many cells leaves of its light to one of `photons`: of the same, where it [owes](LightOctree::owes) some, or of those
    /// after one edit. `None` where it is not known what changed since.
    pub(super) fn of(
        octree: &Arc<LightOctree>,
        photons: &PhotonProduct,
        moved: Vec<[Vec3; 2]>,
    ) -> Option<Reused> {
        let generation = octree.photons.generation;
        let (changed, owed_share) = if generation == photons.generation {
            (octree.owes().then(Changed::default)?, 0.0)
        } else {
            let is_next = generation + 1 == photons.generation;
            (Changed::of(photons.changed.as_ref().filter(|_| is_next)?), OWED_SHARE)
        };
        let sides = octree.photons.maps.surfaces().sides_in(photons.maps.surfaces());
        Some(Reused { octree: octree.clone(), sides, changed, owed_share, moved })
    }

    /// Something came or went that near.
    fn is_moved_within(&self, radius_m: f32, middle: Vec3) -> bool {
        self.moved.iter().any(|[low, high]| {
            middle.distance_squared(middle.clamp(*low, *high)) <= radius_m * radius_m * (1.0 + 1e-5)
        })
    }
}

/// Where photons came or went, for asking how near.
#[derive(Default)]
struct Changed {
    /// By class and side.
    trees: [HashMap<SideId, kiddo::ImmutableKdTree<f32, 3>>; 2],
}

impl std::fmt::Debug for Changed {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Changed").field("sides", &self.trees[0].len()).finish()
    }
}

impl Changed {
    fn of(changed: &ChangedPhotons) -> Changed {
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

    /// How many photons of the class came or went on some of the sides within the radius, at least one if any did.
    fn count_within(&self, class: usize, sides: &[SideId], radius_m: f32, centre: Vec3) -> usize {
        let centre = centre.to_array();
        let radius2 = radius_m * radius_m * (1.0 + 1e-5);
        let of_side = |tree: &kiddo::ImmutableKdTree<f32, 3>| {
            let nearest = tree.query(&centre).nearest_one::<kiddo::SquaredEuclidean<f32>>().execute();
            if nearest.distance > radius2 {
                return 0;
            }
            let within = tree.query(&centre).within::<kiddo::SquaredEuclidean<f32>>(radius2);
            within.unsorted().execute().len().max(1)
        };
        sides.iter().filter_map(|side| self.trees[class].get(side)).map(of_side).sum()
    }
}

impl Building {
    /// The light of the cell before, if neither its surfaces changed nor more photons near them than may be owed.
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
        let is_like = |(old, new): (&VoxelSet, &VoxelSet)| {
            (old.normal, old.centre, old.area_m2) == (new.normal, new.centre, new.area_m2)
                && old.is_alone == new.is_alone
                && same_sides(old, new)
                && !reused.is_moved_within(self.gathers().look_m(new), new.centre)
        };
        let kept = |(set, new): (usize, &VoxelSet)| {
            let light = &octree.gathers[set];
            let mut owed = octree.owed[set];
            for class in 0..MAPPED.len() {
                let sides = self.voxels.sides_of(new);
                let more = reused.changed.count_within(class, sides, light.reach_m[class], new.centre);
                let may_owe = reused.owed_share * f32::from(light.found[class]);
                owed[class] = u16::try_from(usize::from(owed[class]) + more)
                    .ok()
                    .filter(|owed| f32::from(*owed) <= may_owe)?;
            }
            Some(SetLight { owed, ..octree.light_of_set(set) })
        };
        let is_like_before = old_sets.iter().zip(sets).all(is_like);
        if is_like_before { (first..).zip(sets).map(kept).collect() } else { None }
    }
}

impl LightOctree {
    fn light_of_set(&self, set: usize) -> SetLight {
        let (leaf, gather) = (&self.sets[set], &self.gathers[set]);
        SetLight {
            vdls: [0, 1].map(|class| self.vdls_of(leaf, class).to_vec()),
            harmonics: self.harmonics.get(set).copied(),
            found: gather.found,
            owed: self.owed[set],
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

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;

    use glam::{DAffine3, DQuat, DVec3};

    use super::super::{OctreeBuilding, OctreeSettings};
    use super::*;
    use crate::{
        scene::{SceneBuilder, SceneLimits, samples},
        technique::{
            Edit, Products, Step, Technique,
            photons::{PhotonSettings, PhotonTracing},
        },
        transport::World,
    };

    struct Light {
        photons: PhotonTracing,
        octree: OctreeBuilding,
        products: Products,
    }

    impl Light {
        fn new() -> Light {
            let photons = PhotonSettings { emitted_count: 100_000, ..PhotonSettings::default() };
            let octree = OctreeSettings { depth: 5, photon_count: 100_000, ..OctreeSettings::default() };
            Light {
                photons: PhotonTracing::new(photons),
                octree: OctreeBuilding::new(octree),
                products: Products::default(),
            }
        }

        fn is_complete(&self) -> bool {
            self.photons.is_complete() && self.octree.is_complete(self.photons.product())
        }

        fn step_until(&mut self, world: &World, is_over: impl Fn(&Light) -> bool) -> Arc<LightOctree> {
            let cancel = AtomicBool::new(false);
            for _ in 0..100_000 {
                if is_over(self) {
                    return self.octree.octree().unwrap().clone();
                }
                let mut step = Step { world, products: &mut self.products, canvas: None, cancel: &cancel };
                match self.photons.is_complete() {
                    true => self.octree.step(&mut step),
                    false => self.photons.step(&mut step),
                };
            }
            panic!("no end of it");
        }
    }

    fn fresh(world: &World) -> Arc<LightOctree> {
        Light::new().step_until(&World::prepare(world.scene().clone()), Light::is_complete)
    }

    /// The world with its block of mirror made small and put so far aside.
    fn dragged(world: &World, aside_m: f64, light: Option<&mut Light>) -> World {
        let place = DVec3::new(0.8 - aside_m, 0.2, 0.8);
        let at = DAffine3::from_scale_rotation_translation(DVec3::splat(0.02), DQuat::IDENTITY, place);
        let mut builder = SceneBuilder::from_scene(world.scene(), SceneLimits::default());
        builder.set_transform("mirror block", at).unwrap();
        let (scene, change) = builder.finish();
        let after = world.update(Arc::new(scene), &change);
        light.into_iter().for_each(|light| {
            let edit = Edit { before: world, after: &after, change: &change };
            light.photons.apply(&edit);
            light.octree.apply(&edit);
        });
        after
    }

    /// What gets much other light by an edit is shown first. Whatever owes nothing, also of edits before, is as in a fresh build, and the others
    /// owe no more than is allowed; in the end all is.
    #[test]
    fn what_gets_much_other_light_comes_first() {
        let mut world = dragged(&World::prepare(Arc::new(samples::cornell_box().unwrap())), 0.0, None);
        let mut light = Light::new();
        assert!(!light.step_until(&world, Light::is_complete).owes());
        for number in 1..=4 {
            world = dragged(&world, 0.02 * f64::from(number), Some(&mut light));
            let octree = light.step_until(&world, |light| {
                let octree = light.octree.octree().unwrap();
                light.photons.is_complete() && octree.photons.generation == light.photons.product().generation
            });
            assert!(octree.owes() && !light.is_complete());
            assert!(octree.counts().gathered > 0 && octree.counts().kept > octree.counts().gathered);
            let fresh = fresh(&world);
            let mut owing = 0;
            for (set, owed) in octree.owed.iter().enumerate() {
                if *owed == [0; 2] {
                    assert_eq!(octree.light_of_set(set), fresh.light_of_set(set), "edit {number}, {set}");
                    continue;
                }
                owing += 1;
                for (owed, found) in owed.iter().zip(octree.gathers[set].found) {
                    assert!(f32::from(*owed) <= OWED_SHARE * f32::from(found), "{owed} of {found}");
                }
            }
            assert!(owing > 3, "{owing}");
        }
        let kept = light.step_until(&world, Light::is_complete);
        assert!(!kept.owes() && kept.counts().gathered > 0 && kept.counts().kept > 0);
        assert!(kept.holds_the_same(&fresh(&world)));
    }
}
