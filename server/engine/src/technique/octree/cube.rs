//! The cube that the octree cuts up, and where its cells begin and end.
//!
//! Where the scene's smaller things fill it all cells are as large. Where wide ground lies around them, cells are small where they
//! are and grow with the distance: along each axis the places of cells are the mean of those of cubes around
//! [`NestedBounds`], which photons of sun and sky are aimed at likewise. So cells get about as many photons for the square of their longest
//! side wherever they lie, and all that is told in sides of a cell holds everywhere. Beside a small cube, in line with it along one axis
//! alone, cells are long: short along that axis, and as long along the others as they would be far away.

use std::sync::Arc;

use glam::{DVec3, UVec3, Vec3};

use crate::{scene::NestedBounds, transport::World};

/// Room around cells for triangles that end at them, in sides of a cell and, for rounding, in distances from the origin.
const SLACK_CELLS: f32 = 1e-4;
const SLACK_ROUNDING: f32 = 1e-6;
/// How far off a place in cells may be by rounding, where cells differ.
const PLACE_ROUNDING_CELLS: f32 = 1e-3;
/// Cubes within the cube, where there are any.
pub(super) const INNER: usize = NestedBounds::COUNT - 1;

/// The cube that the octree cuts up, in render space.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Cube {
    pub(super) low: Vec3,
    pub(super) side_m: f32,
    /// Halvings of the cube.
    pub(super) depth: u32,
    /// Cells are smaller there.
    pub(super) nested: Option<Arc<Nested>>,
}

/// What makes cells differ.
#[derive(Debug, PartialEq)]
pub(super) struct Nested {
    /// Low corner and side of cubes, each within the one before and all within the whole one.
    pub(super) inner: [(Vec3, f32); INNER],
    /// `[cells + 1]`: where cells begin along each axis.
    planes: Vec<Vec3>,
}

impl Cube {
    /// Around the scene; `None` for one without surface.
    pub(super) fn around(world: &World, depth: u32) -> Option<Cube> {
        let accel = world.accel();
        let bounds = accel.instances().iter().map(|i| *i.bounds_in_world()).reduce(|a, b| a.union(&b))?;
        let (low, side_m) = accel.cube_around(&bounds);
        if !(side_m > 0.0 && side_m.is_finite()) {
            return None;
        }
        let nested = world.nested_bounds().and_then(|bounds| {
            let [_, inner @ ..] = bounds.boxes.map(|of| accel.cube_around(&of));
            Nested::within((low, side_m), inner, 1 << depth).map(Arc::new)
        });
        Some(Cube { low, side_m, depth, nested })
    }

    pub(super) fn cells(&self) -> u32 {
        1 << self.depth
    }

    /// Side of a cell where all are as large; its largest side elsewhere is [`Cube::scale_at`] times as much.
    pub(super) fn cell_m(&self) -> f32 {
        self.side_m / self.cells() as f32
    }

    /// Where a point is, in cells from the low corner; outside of the cube as well.
    #[inline]
    pub(super) fn place_of(&self, p: Vec3) -> Vec3 {
        match &self.nested {
            None => (p - self.low) / self.cell_m(),
            Some(nested) => {
                let of = |(low, side_m): (Vec3, f32)| (p - low) / side_m;
                let inner = nested.inner.iter().map(|cube| of(*cube).clamp(Vec3::ZERO, Vec3::ONE));
                let sum = inner.fold(of((self.low, self.side_m)), |sum, share| sum + share);
                sum * (self.cells() as f32 / NestedBounds::COUNT as f32)
            }
        }
    }

    /// Sides of cells at a point over [`Cube::cell_m`].
    #[inline]
    pub(super) fn scale_at(&self, p: Vec3) -> Vec3 {
        let Some(nested) = &self.nested else { return Vec3::ONE };
        let inner = nested.inner.iter().map(|(low, side_m)| {
            let is_in = p.cmpge(*low) & p.cmple(*low + *side_m);
            Vec3::select(is_in, Vec3::splat(self.side_m / side_m), Vec3::ZERO)
        });
        NestedBounds::COUNT as f32 / inner.fold(Vec3::ONE, |sum, share| sum + share)
    }

    /// The smallest cell that surely holds all of a triangle that is inside the cube, and its level: most are as small as a leaf, and
    /// to follow each down from the top took a third of the time of a coarse octree.
    pub(super) fn around_all(&self, [a, b, c]: [Vec3; 3]) -> (UVec3, u32) {
        let farthest = self.low.abs().max((self.low + self.side_m).abs());
        let slack = 2.0 * SLACK_ROUNDING * farthest;
        let slack_cells = 2.0 * SLACK_CELLS + self.nested.as_ref().map_or(0.0, |_| PLACE_ROUNDING_CELLS);
        let last = Vec3::splat((self.cells() - 1) as f32);
        let cell_of = |place: Vec3| place.clamp(Vec3::ZERO, last).as_uvec3();
        let low = cell_of(self.place_of(a.min(b).min(c) - slack) - slack_cells);
        let high = cell_of(self.place_of(a.max(b).max(c) + slack) + slack_cells);
        let differing = (low.x ^ high.x) | (low.y ^ high.y) | (low.z ^ high.z);
        let height = (u32::BITS - differing.leading_zeros()).min(self.depth);
        (UVec3::new(low.x >> height, low.y >> height, low.z >> height), self.depth - height)
    }

    /// Corners of a cell so many levels below the whole cube. Neighbours agree on the plane between them: both are from whole numbers.
    pub(super) fn corners(&self, cell: UVec3, level: u32) -> [Vec3; 2] {
        [cell, cell + UVec3::ONE].map(|cell| match &self.nested {
            None => self.low + cell.as_vec3() * (self.side_m / (1u32 << level) as f32),
            Some(nested) => {
                let [x, y, z] = cell.to_array().map(|plane| (plane << (self.depth - level)) as usize);
                Vec3::new(nested.planes[x].x, nested.planes[y].y, nested.planes[z].z)
            }
        })
    }

    /// Cells that a surface of an area in some bounds is about as large as, where it lies evenly along their two longest sides.
    pub(super) fn area_in_cells(&self, area_m2: f64, bounds: [Vec3; 2]) -> f64 {
        let [low, high] = bounds;
        let cells = self.place_of(high) - self.place_of(low);
        // Cells a metre.
        let even = 1.0 / self.cell_m();
        let mut along = [0, 1, 2].map(|axis| {
            let side_m = high[axis] - low[axis];
            (side_m, if side_m > 0.0 { cells[axis] / side_m } else { even })
        });
        along.sort_by(|a, b| b.0.total_cmp(&a.0));
        area_m2 * f64::from(along[0].1) * f64::from(along[1].1)
    }

    /// Sides of a cell, m.
    pub(super) fn size_of(&self, cell: UVec3) -> Vec3 {
        match &self.nested {
            None => Vec3::splat(self.cell_m()),
            Some(_) => {
                let [low, high] = self.corners(cell, self.depth);
                high - low
            }
        }
    }

    /// The largest side of a cell over [`Cube::cell_m`].
    pub(super) fn scale_of(&self, cell: UVec3) -> f32 {
        self.nested.as_ref().map_or(1.0, |_| self.size_of(cell).max_element() / self.cell_m())
    }

    /// Room around a box for triangles that end at it.
    pub(super) fn slack(low: Vec3, size: Vec3) -> Vec3 {
        size * SLACK_CELLS + low.abs() * SLACK_ROUNDING
    }
}

impl Nested {
    /// `None` where a cube is of no extent, or its cells of less than rounding leaves whole.
    fn within(whole: (Vec3, f32), inner: [(Vec3, f32); INNER], cells: u32) -> Option<Nested> {
        let mut around = whole;
        let inner = inner.map(|(low, side_m)| {
            let side_m = side_m.min(around.1);
            let low = low.clamp(around.0, around.0 + (around.1 - side_m));
            around = (low, side_m);
            around
        });
        // More than rounding, also where cells are smallest.
        let farthest = whole.0.abs().max((whole.0 + whole.1).abs()).max_element();
        let smallest_m = around.1 / cells as f32;
        if !(smallest_m > 16.0 * f32::EPSILON * farthest) {
            return None;
        }
        let planes = (0..=cells).map(|plane| plane_at(whole, &inner, f64::from(plane) / f64::from(cells)));
        Some(Nested { inner, planes: planes.collect() })
    }
}

/// Where the mean of the places in all cubes is `share`, along each axis.
fn plane_at(whole: (Vec3, f32), inner: &[(Vec3, f32); INNER], share: f64) -> Vec3 {
    let cubes: Vec<(DVec3, f64)> =
        [whole].iter().chain(inner).map(|(low, side_m)| (low.as_dvec3(), f64::from(*side_m))).collect();
    let along = |axis: usize| {
        let place_of = |x: f64| {
            let of = |(low, side_m): &(DVec3, f64)| ((x - low[axis]) / side_m).clamp(0.0, 1.0);
            cubes.iter().map(of).sum::<f64>() / cubes.len() as f64
        };
        // Straight between where cubes begin and end.
        let lows = cubes.iter().map(|(low, _)| low[axis]);
        let highs = cubes.iter().rev().map(|(low, side_m)| low[axis] + side_m);
        let knots: Vec<f64> = lows.chain(highs).collect();
        let after = knots.iter().position(|knot| place_of(*knot) >= share).unwrap_or(knots.len() - 1);
        let (low, high) = (knots[after.saturating_sub(1)], knots[after]);
        let (from, to) = (place_of(low), place_of(high));
        if to > from { low + (high - low) * ((share - from) / (to - from)).clamp(0.0, 1.0) } else { high }
    };
    DVec3::from_array([0, 1, 2].map(along)).as_vec3()
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::math::sobol::point;

    /// A cube with smaller ones in it, or all alike for an odd number.
    pub(in super::super) fn cube(low: Vec3, depth: u32, number: u32) -> Cube {
        let inner = [0.4, 0.16, 0.06].map(|side_m| (low + Vec3::new(0.55, 0.97 - side_m, 0.1), side_m));
        let nested = Nested::within((low, 1.0), inner, 1 << depth).filter(|_| number.is_multiple_of(2));
        Cube { low, side_m: 1.0, depth, nested: nested.map(Arc::new) }
    }

    /// The places of planes between cells are whole, cells are as large as it says, and small where the smallest cube is.
    #[test]
    fn places_of_planes_are_whole() {
        for (number, low) in
            [Vec3::ZERO, Vec3::splat(-30.5), Vec3::new(7.0, -0.5, 3.0)].into_iter().enumerate()
        {
            let cube = cube(low, 6, 2 * number as u32);
            for plane in 0..64 {
                let [from, to] = cube.corners(UVec3::splat(plane), 6);
                assert!(to.cmpgt(from).all(), "{plane}");
                let off = (cube.place_of(from) - plane as f32).abs();
                assert!(off.max_element() < 2e-3 * (1.0 + low.abs().max_element()), "{plane}: {off}");
            }
            assert_eq!(cube.corners(UVec3::ZERO, 0)[0], low);
            assert!((cube.corners(UVec3::ZERO, 0)[1] - low - 1.0).abs().max_element() < 1e-5);
            for index in 0..200 {
                let [x, y, z, _] = point(3, index);
                let p = low + Vec3::new(x, y, z);
                let cell = cube.place_of(p).floor();
                let [from, to] = cube.corners(cell.as_uvec3(), 6);
                let said = cube.scale_at((from + to) * 0.5) * cube.cell_m();
                let off = (cube.size_of(cell.as_uvec3()) / said - 1.0).abs();
                // A cell on the border of a cube is partly of both.
                let is_inside =
                    cube.scale_at(from + 1e-3 * (to - from)) == cube.scale_at(to - 1e-3 * (to - from));
                assert!(!is_inside || off.max_element() < 1e-2, "{p}: {off}");
            }
            let fine = cube.scale_at(cube.nested.as_ref().unwrap().inner[2].0 + 0.03);
            assert!(fine.max_element() < 0.17, "{fine}");
        }
    }

    /// Without smaller cubes all is as without the idea of them.
    #[test]
    fn cells_that_are_alike_are_plain() {
        let cube = cube(Vec3::splat(-0.25), 5, 1);
        assert_eq!(cube.scale_at(Vec3::splat(0.1)), Vec3::ONE);
        assert_eq!(cube.place_of(Vec3::ZERO), Vec3::splat(8.0));
        assert_eq!(cube.corners(UVec3::splat(3), 3), [Vec3::splat(0.125), Vec3::splat(0.25)]);
    }

    /// Where cells would be finer than numbers are, all are as large.
    #[test]
    fn cells_are_never_finer_than_rounding() {
        let inner = [1e-2, 1e-4, 1e-6].map(|side_m| (Vec3::splat(1.0), side_m));
        assert!(Nested::within((Vec3::ZERO, 2.0), inner, 1024).is_none());
        assert!(
            Nested::within((Vec3::ZERO, 2.0), [1.0, 0.1, 0.0].map(|side_m| (Vec3::ONE, side_m)), 16)
                .is_none()
        );
    }
}
