//! Walls between groups: what is known on one side of them is not for the other.
//!
//! A cell is wider than a wall, and a look-up blends the cells around it. Where two groups that face alike lie on either side of a
//! wall and get different light, each counts for next to nothing on the other's side.

use glam::{Vec3, Vec4};
use rayon::prelude::*;

use super::voxels::Voxels;
use crate::technique::{LIKE_COS, Walls};

/// Groups whose irradiances differ by more than this are parted: less is left to blend, since a plane goes on where its wall ends.
const PARTED_TIMES: f32 = 2.0;

/// A plane that keeps a group from what lies behind it: unit direction away from the group, and how far along it from the origin the
/// plane lies, m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Parting(pub(super) Vec4);

impl Parting {
    /// Nothing is behind it.
    pub(super) const NONE: Parting = Parting(Vec4::new(0.0, 0.0, 0.0, f32::MAX));
    /// The group lies within a wall: everything is behind that.
    const ALL: Parting = Parting(Vec4::new(0.0, 0.0, 0.0, -f32::MAX));

    #[inline]
    pub(super) fn is_behind(self, p: Vec3) -> bool {
        self.behind_m(p) > 0.0
    }

    #[inline]
    fn behind_m(self, p: Vec3) -> f32 {
        self.0.truncate().dot(p) - self.0.w
    }

    /// As the groups behind it see it.
    fn turned(self) -> Parting {
        Parting(-self.0)
    }
}

/// The two nearest walls around a group.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct NearWalls([Parting; 2]);

impl NearWalls {
    /// Of a group within a wall.
    pub(super) const WITHIN: NearWalls = NearWalls([Parting::ALL; 2]);

    /// As far as look-ups near the group go; `None` where there is none.
    pub(super) fn of(walls: &Walls, middle: Vec3, within_m: f32) -> Option<NearWalls> {
        let mut near = NearWalls([Parting::NONE; 2]);
        let found = walls.nearest_first().filter(|(_, distance_m)| *distance_m <= within_m);
        for (wall, (away, distance_m)) in near.0.iter_mut().zip(found) {
            *wall = Parting(away.extend(away.dot(middle) + distance_m));
        }
        (near.0[0] != Parting::NONE).then_some(near)
    }
}

/// The groups that walls keep from others with other light, each with the nearest of these walls.
///
/// - `walls`: `[groups]`, around each
/// - `irradiance`: `[groups]`, W/m²
pub(super) fn parted(
    voxels: &Voxels,
    walls: &[Option<NearWalls>],
    irradiance: &[f32],
) -> Vec<(usize, Parting)> {
    let of_cell = |cell: usize| {
        let mut found: Vec<(usize, Parting)> = Vec::new();
        if !walls[voxels.places_of(cell)].iter().any(Option::is_some) {
            return found;
        }
        let around = voxels.cells_around(cell);
        let others: Vec<usize> = around.into_iter().flat_map(|cell| voxels.places_of(cell)).collect();
        for place in voxels.places_of(cell) {
            let Some(NearWalls(near)) = walls[place] else { continue };
            if near[0] == Parting::ALL {
                found.push((place, near[0]));
                continue;
            }
            let here = &voxels.sets[place];
            for wall in near {
                let is_kept_from = |other: &usize| {
                    let there = &voxels.sets[*other];
                    wall.is_behind(there.centre)
                        && here.normal.dot(there.normal) > LIKE_COS
                        && differ(irradiance[place], irradiance[*other])
                };
                let first = found.len();
                found.extend(others.iter().copied().filter(is_kept_from).map(|other| (other, wall.turned())));
                if found.len() > first {
                    found.push((place, wall));
                }
            }
        }
        found
    };
    let mut found: Vec<(usize, Parting)> =
        (0..voxels.codes.len()).into_par_iter().flat_map_iter(of_cell).collect();
    // Neighbours name the same wall over and over.
    let distance_m = |(place, wall): &(usize, Parting)| -wall.behind_m(voxels.sets[*place].centre);
    found.sort_by(|a, b| a.0.cmp(&b.0).then(distance_m(a).total_cmp(&distance_m(b))));
    found.dedup_by_key(|(place, _)| *place);
    found
}

fn differ(a: f32, b: f32) -> bool {
    a.max(b) > PARTED_TIMES * a.min(b)
}
