//! Walls between groups: what is known on one side of them is not for the other.
//!
//! A cell is wider than a wall, and a look-up blends the cells around it. Where two groups that face alike lie on either side of a
//! wall and get different light, each counts for next to nothing on the other's side; and so do two sheets, one above the other, of which
//! one is dim beside the other, on either side of the plane midway between them.

use glam::{Vec3, Vec4};
use rayon::prelude::*;

use super::{
    gathers::LIFT_CELLS,
    voxels::{VoxelSet, Voxels},
};
use crate::technique::{LIKE_COS, Walls};

/// Groups whose irradiances differ by more than this are parted: less is left to blend, since a plane goes on where its wall ends.
const PARTED_TIMES: f32 = 2.0;

/// Groups may be two sheets if they lie so many sides of a cell apart …
const SHEETS_APART_CELLS: f32 = 1e-3;
/// … and so many distances from the origin, which places are rounded by.
const SHEETS_APART_ROUNDING: f32 = 32.0 * f32::EPSILON;
/// A group that has at most this share of another's irradiance is dim beside it: what it takes from that shows, such as the outside of a lamp's
/// shade from its inside, and what it gives does not. Two that are about as bright are told apart by how far off they are alone.
const DIM_SHARE: f32 = 0.1;
/// With this share it is as good as unlit, and has no light to leak past a wall.
const UNLIT_SHARE: f32 = 1e-3;

/// Share of a group whose light a wall keeps off …
pub(super) const BEHIND_SHARE: f32 = 1e-6;
/// … and of one that lies within a wall.
pub(super) const WITHIN_SHARE: f32 = 1e-3;

/// A plane that keeps a group from what lies behind it: unit direction away from the group, and how far along it from the origin the
/// plane lies, m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Parting(pub(super) Vec4);

impl Parting {
    /// Nothing is behind it.
    pub(super) const NONE: Parting = Parting(Vec4::new(0.0, 0.0, 0.0, f32::MAX));
    /// The group lies within a wall: everything is behind that.
    const ALL: Parting = Parting(Vec4::new(0.0, 0.0, 0.0, -f32::MAX));

    /// How much a group counts at `p`. Beyond its wall less than one within a wall, which often has no light: in a room that is dark all
    /// over those are what there is.
    #[inline]
    pub(super) fn share_at(self, p: Vec3) -> f32 {
        match (self.is_behind(p), self.0.w < 0.5 * Parting::ALL.0.w) {
            (false, _) => 1.0,
            (true, true) => WITHIN_SHARE,
            (true, false) => BEHIND_SHARE,
        }
    }

    #[inline]
    fn is_behind(self, p: Vec3) -> bool {
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

/// Of each group the nearest plane that keeps it from another with other light, `[groups]`: a wall that stands on both, or one between two
/// sheets that lie one above the other.
///
/// - `walls`: `[groups]`, around each
/// - `irradiance`: `[groups]`, W/m²
/// - `is_between`: something stands between two points; the plane of a wall goes on where the wall ends, in a doorway
pub(super) fn parted(
    voxels: &Voxels,
    walls: &[Option<NearWalls>],
    irradiance: &[f32],
    is_between: impl Fn([Vec3; 2]) -> bool + Sync,
) -> Vec<Parting> {
    let of_cell = |cell: usize| {
        let around = voxels.cells_around(cell);
        let others: Vec<usize> = around.into_iter().flat_map(|cell| voxels.places_of(cell)).collect();
        let of_place = |place: usize| {
            if walls[place] == Some(NearWalls::WITHIN) {
                return Parting::ALL;
            }
            let here = &voxels.sets[place];
            let mut nearest = (f32::INFINITY, Parting::NONE);
            let mut nearest_sheet = nearest;
            for other in &others {
                let there = &voxels.sets[*other];
                if here.normal.dot(there.normal) <= LIKE_COS || !differ(irradiance[place], irradiance[*other])
                {
                    continue;
                }
                let own = near(walls[place]).filter(|wall| wall.is_behind(there.centre));
                let its =
                    near(walls[*other]).map(Parting::turned).filter(|wall| wall.is_behind(there.centre));
                let distance = |wall: &Parting| -wall.behind_m(here.centre);
                let found = own.chain(its).map(|wall| (distance(&wall), wall));
                let nearer = |(distance_m, _): &(f32, Parting)| (0.0..nearest.0).contains(distance_m);
                if let Some(wall) = found.filter(nearer).min_by(|a, b| a.0.total_cmp(&b.0))
                    && is_between([lifted(here), lifted(there)])
                {
                    nearest = wall;
                }
                let [own, its] = [irradiance[place], irradiance[*other]];
                if own.min(its) > DIM_SHARE * own.max(its) {
                    continue;
                }
                let Some((wall, distance_m, above)) = sheets_apart(here, there) else { continue };
                let is_unlit = own <= UNLIT_SHARE * its;
                let nearest = if is_unlit { &mut nearest } else { &mut nearest_sheet };
                if distance_m < nearest.0 && is_between(above) {
                    *nearest = (distance_m, wall);
                }
            }
            // Of what has light to leak a wall that it needs comes first.
            if nearest.1 == Parting::NONE { nearest_sheet.1 } else { nearest.1 }
        };
        voxels.places_of(cell).map(of_place).collect::<Vec<Parting>>()
    };
    (0..voxels.codes.len()).into_par_iter().flat_map_iter(of_cell).collect()
}

fn lifted(set: &VoxelSet) -> Vec3 {
    set.centre + set.normal * (LIFT_CELLS * set.across_m)
}

/// The plane midway between two groups that face alike, seen from `here`, how far from there it is, m, and a way straight up from midway above
/// the lower to over the upper, which that crosses if it lies over the middle of the lower. `None` where they are not told apart by how far
/// off they are; groups of one curved sheet are, but it does not lie over itself.
///
/// Most that are parted so are insides of walls and shells, on which no light falls: they took up to half of the light of the faces that are
/// seen, where cells begin between the two. A look-up tells sheets apart by how far off they are, less well the wider cells are.
fn sheets_apart(here: &VoxelSet, there: &VoxelSet) -> Option<(Parting, f32, [Vec3; 2])> {
    let n = here.normal;
    let above_m = n.dot(there.centre - here.centre);
    let farthest_m = here.centre.abs().max(there.centre.abs()).max_element();
    let least_m = (SHEETS_APART_CELLS * here.across_m).max(SHEETS_APART_ROUNDING * farthest_m);
    if !(above_m.abs() > least_m) {
        return None;
    }
    let midway_m = 0.5 * above_m.abs();
    let away = if above_m > 0.0 { n } else { -n };
    let wall = Parting(away.extend(away.dot(here.centre) + midway_m));
    let (lower, upper) = if above_m > 0.0 { (here, there) } else { (there, here) };
    let up = |by_m: f32| lower.centre + n * by_m;
    Some((wall, midway_m, [up(midway_m), up(above_m.abs() + LIFT_CELLS * upper.across_m)]))
}

fn near(walls: Option<NearWalls>) -> impl Iterator<Item = Parting> {
    walls.into_iter().filter(|walls| *walls != NearWalls::WITHIN).flat_map(|walls| walls.0)
}

fn differ(a: f32, b: f32) -> bool {
    a.max(b) > PARTED_TIMES * a.min(b)
}
