//! Photon maps: one per side of every crease surface and class of light; `gather.rs` reads them.

use std::{num::NonZeroUsize, sync::Arc};

use glam::Vec3;
use kiddo::ImmutableKdTree;
use rayon::prelude::*;

use super::surfaces::{SideId, Surfaces, TriangleSide};
use crate::{
    math::{Rgb, octahedral},
    transport::PathClass,
};

/// Classes of light that maps are made for: what falls straight from lights is computed better without photons.
pub const MAPPED: [PathClass; 2] = [PathClass::Indirect, PathClass::Caustic];

/// The photons of one class on one side of a surface.
pub struct SideMap {
    pub(super) tree: ImmutableKdTree<f32, 3>,
    pub(super) photons: Vec<MapPhoton>,
}

impl std::fmt::Debug for SideMap {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("SideMap").field("photons", &self.photons.len()).finish()
    }
}

/// A photon on its way into a map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FallenPhoton {
    /// Where, in render space.
    pub position: Vec3,
    /// Flux, W.
    pub flux: Rgb,
    /// Where it came from, octahedral.
    pub direction: u32,
}

/// A photon in a map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapPhoton {
    /// Where, in render space.
    pub position: Vec3,
    /// Flux, W.
    pub flux: Rgb,
    /// Where it came from, octahedral.
    pub direction: u32,
    /// Normal of the surface on the side it fell on, octahedral.
    pub normal: u32,
}

/// The photon maps of a scene, by class and side.
#[derive(Clone, Debug, Default)]
pub struct PhotonMaps {
    pub(super) surfaces: Arc<Surfaces>,
    /// `[class][side]`.
    pub(super) sides: [Vec<Option<Arc<SideMap>>>; 2],
    /// `[class]`.
    photon_counts: [usize; 2],
}

impl PhotonMaps {
    /// Maps of all photons; `kept(class, side)` gives those that are as they were.
    ///
    /// - `all`: every photon with its class and place; those of classes without maps are left out
    /// - `normal_of`: unit normal of a triangle on a side of it
    pub(in crate::technique) fn of(
        all: impl IntoParallelIterator<Item = (PathClass, TriangleSide, FallenPhoton)>,
        surfaces: Arc<Surfaces>,
        normal_of: impl Fn(TriangleSide) -> Vec3 + Sync,
        kept: impl Fn(usize, SideId) -> Option<Option<Arc<SideMap>>>,
    ) -> PhotonMaps {
        let side_count = 2 * surfaces.count() as usize;
        let mut sides: [Vec<Option<Arc<SideMap>>>; 2] = std::array::from_fn(|_| vec![None; side_count]);
        let mut is_open = [vec![true; side_count], vec![true; side_count]];
        for class in 0..MAPPED.len() {
            for side in 0..side_count {
                if let Some(map) = kept(class, SideId::at(side)) {
                    sides[class][side] = map;
                    is_open[class][side] = false;
                }
            }
        }
        // All threads look up what photons need; one puts them in their maps, in order.
        let placed = all.into_par_iter().filter_map(|(class, place, photon)| {
            let class = MAPPED.iter().position(|mapped| *mapped == class)?;
            let side = surfaces.side(place).index();
            is_open[class][side].then(|| {
                let FallenPhoton { position, flux, direction } = photon;
                let normal = octahedral::encode(normal_of(place));
                (class, side, MapPhoton { position, flux, direction, normal })
            })
        });
        let placed = placed.collect_vec_list();
        let mut counts = [vec![0; side_count], vec![0; side_count]];
        placed.iter().flatten().for_each(|(class, side, _)| counts[*class][*side] += 1);
        let mut photons: [Vec<Vec<MapPhoton>>; 2] =
            counts.map(|counts| counts.into_iter().map(Vec::with_capacity).collect());
        for (class, side, photon) in placed.into_iter().flatten() {
            photons[class][side].push(photon);
        }
        for (maps, photons) in sides.iter_mut().zip(photons) {
            maps.par_iter_mut().zip(photons).filter(|(_, photons)| !photons.is_empty()).for_each(
                |(map, photons)| {
                    *map = SideMap::of(photons).map(Arc::new);
                },
            );
        }
        let count =
            |maps: &Vec<Option<Arc<SideMap>>>| maps.iter().flatten().map(|map| map.photons.len()).sum();
        let photon_counts = [count(&sides[0]), count(&sides[1])];
        PhotonMaps { surfaces, sides, photon_counts }
    }

    /// The surfaces they lie on.
    pub fn surfaces(&self) -> &Arc<Surfaces> {
        &self.surfaces
    }

    /// The map of a side, by class as in [`MAPPED`].
    pub fn side_map(&self, class: usize, side: SideId) -> &Option<Arc<SideMap>> {
        &self.sides[class][side.index()]
    }

    /// True when photons of any class lie on any of some sides.
    pub fn has_any(&self, sides: &[SideId]) -> bool {
        sides.iter().any(|side| self.sides.iter().any(|maps| maps[side.index()].is_some()))
    }

    /// Photons in all maps of a class.
    pub fn photon_count(&self, class: PathClass) -> usize {
        MAPPED.iter().position(|mapped| *mapped == class).map_or(0, |index| self.photon_counts[index])
    }

    /// Sides that photons of a class lie on.
    pub fn map_count(&self, class: PathClass) -> usize {
        let Some(index) = MAPPED.iter().position(|mapped| *mapped == class) else { return 0 };
        self.sides[index].iter().flatten().count()
    }

    /// Memory of photons and trees.
    pub fn bytes(&self) -> usize {
        let photons: usize = self.photon_counts.iter().sum();
        // kiddo keeps a position and a number for each.
        photons * (size_of::<MapPhoton>() + 16)
            + self.surfaces.bytes()
            + self.sides.iter().map(|sides| sides.len() * size_of::<Option<Arc<SideMap>>>()).sum::<usize>()
    }
}

impl SideMap {
    fn of(mut photons: Vec<MapPhoton>) -> Option<SideMap> {
        // Neighbours in space become neighbours in memory: gathers then take half the time.
        photons.par_sort_by_cached_key(|photon| place_on_a_curve(photon.position));
        let positions: Vec<[f32; 3]> = photons.iter().map(|photon| photon.position.to_array()).collect();
        // Only more photons than u32 can count are refused, and none at all.
        let tree =
            NonZeroUsize::new(positions.len()).and_then(|_| ImmutableKdTree::new_from_slice(&positions).ok());
        Some(SideMap { tree: tree?, photons })
    }
}

/// Where a point comes on a curve that visits near points soon after each other. Depends on nothing but the point: the order
/// of some photons must not depend on others.
fn place_on_a_curve(p: Vec3) -> u64 {
    // Upper bits of numbers whose order is that of the floats.
    let ordered = |x: f32| {
        let bits = x.to_bits();
        u64::from((if bits >> 31 == 0 { bits | 1 << 31 } else { !bits }) >> 11)
    };
    // To every third bit.
    let spread = |mut x: u64| {
        x = (x | x << 32) & 0x001f_0000_0000_ffff;
        x = (x | x << 16) & 0x001f_0000_ff00_00ff;
        x = (x | x << 8) & 0x100f_00f0_0f00_f00f;
        x = (x | x << 4) & 0x10c3_0c30_c30c_30c3;
        (x | x << 2) & 0x1249_2492_4924_9249
    };
    spread(ordered(p.x)) | spread(ordered(p.y)) << 1 | spread(ordered(p.z)) << 2
}
