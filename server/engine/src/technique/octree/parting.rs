//! Walls between groups: what is known on one side of them is not for the other.
//!
//! A cell is wider than a wall, and a look-up blends the cells around it. Where two groups that face alike lie on either side of a
//! wall and get different light, each counts for next to nothing on the other's side.

use glam::{Vec3, Vec4};
use rayon::prelude::*;

use super::voxels::{VoxelSet, Voxels};
use crate::technique::{LIKE_COS, Walls};

/// Groups whose irradiances differ by more than this are parted: less is left to blend, since a plane goes on where its wall ends.
const PARTED_TIMES: f32 = 2.0;

/// The nearest walls around a group.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Parting {
    /// Unit direction away from the group, and how far along it from the origin the plane lies, m.
    pub(super) planes: [Vec4; 2],
}

impl Parting {
    /// No plane: nothing is behind it.
    const NOTHING: Vec4 = Vec4::new(0.0, 0.0, 0.0, f32::MAX);
    /// The group lies within a wall: everything is behind that.
    pub(super) const ALL: Parting = Parting { planes: [Vec4::new(0.0, 0.0, 0.0, -f32::MAX); 2] };

    /// The two nearest of the walls around a group as far as look-ups near it go; `None` where there is none.
    pub(super) fn by(walls: &Walls, middle: Vec3, within_m: f32) -> Option<Parting> {
        let near = walls.nearest_first().filter(|(_, distance_m)| *distance_m <= within_m);
        Parting::of(near.map(|(away, distance_m)| away.extend(away.dot(middle) + distance_m)))
    }

    fn of(nearest_first: impl Iterator<Item = Vec4>) -> Option<Parting> {
        let mut parting = Parting { planes: [Parting::NOTHING; 2] };
        let mut is_any = false;
        for (place, plane) in parting.planes.iter_mut().zip(nearest_first) {
            *place = plane;
            is_any = true;
        }
        is_any.then_some(parting)
    }

    #[inline]
    pub(super) fn is_behind(&self, p: Vec3) -> bool {
        self.planes.iter().any(|plane| behind_m(plane, p) > 0.0)
    }
}

fn behind_m(plane: &Vec4, p: Vec3) -> f32 {
    plane.truncate().dot(p) - plane.w
}

/// A plane that keeps a group from others.
#[derive(Clone, Copy, Debug)]
struct Parted {
    set: usize,
    /// From the group's middle, m.
    distance_m: f32,
    plane: Vec4,
}

/// The groups that walls keep from others with other light, ascending, with the two nearest planes of each.
///
/// - `walls`: `[groups]`, around each
/// - `irradiance`: `[groups]`, W/m²
pub(super) fn parted(
    voxels: &Voxels,
    walls: &[Option<Parting>],
    irradiance: &[f32],
) -> Vec<(usize, Parting)> {
    let of_cell = |cell: usize| {
        let sets = voxels.first_set[cell] as usize..voxels.first_set[cell + 1] as usize;
        let around = if walls[sets.clone()].iter().any(Option::is_some) {
            voxels.cells_around(cell)
        } else {
            Vec::new()
        };
        let others: Vec<usize> = around
            .into_iter()
            .flat_map(|cell| voxels.first_set[cell] as usize..voxels.first_set[cell + 1] as usize)
            .collect();
        let mut found = Vec::new();
        for set in sets {
            let Some(parting) = walls[set] else { continue };
            if parting == Parting::ALL {
                found.push(Parted { set, distance_m: 0.0, plane: parting.planes[0] });
                continue;
            }
            let here = &voxels.sets[set];
            for plane in parting.planes {
                let mut is_parted = false;
                for other in others.iter().copied() {
                    let there = &voxels.sets[other];
                    let off_m = behind_m(&plane, there.centre);
                    if off_m > 0.0 && faces_alike(here, there) && differ(irradiance[set], irradiance[other]) {
                        is_parted = true;
                        found.push(Parted { set: other, distance_m: off_m, plane: -plane });
                    }
                }
                if is_parted {
                    found.push(Parted { set, distance_m: -behind_m(&plane, here.centre), plane });
                }
            }
        }
        found
    };
    let mut found: Vec<Parted> = (0..voxels.codes.len()).into_par_iter().flat_map_iter(of_cell).collect();
    found.sort_by(|a, b| a.set.cmp(&b.set).then(a.distance_m.total_cmp(&b.distance_m)));
    found
        .chunk_by(|a, b| a.set == b.set)
        .filter_map(|of_set| {
            // Neighbours name the same wall over and over.
            let mut planes: Vec<Vec4> = of_set.iter().map(|parted| parted.plane).collect();
            planes.dedup_by(|next, kept| is_same(next, kept));
            Some((of_set[0].set, Parting::of(planes.into_iter())?))
        })
        .collect()
}

fn faces_alike(a: &VoxelSet, b: &VoxelSet) -> bool {
    a.normal.dot(b.normal) > LIKE_COS
}

fn differ(a: f32, b: f32) -> bool {
    a.max(b) > PARTED_TIMES * a.min(b)
}

/// Planes of one direction: the nearest of them counts.
fn is_same(a: &Vec4, b: &Vec4) -> bool {
    a.truncate().dot(b.truncate()) > 0.99
}
