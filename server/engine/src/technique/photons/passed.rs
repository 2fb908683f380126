//! Where photons flew, roughly: a bit for each cell of a coarse grid that a path passes. An edit holds its boxes against eight
//! bytes of a path, and only against the segments of paths that passed a cell which it touched.

use glam::{IVec3, Vec3};

use crate::{
    accel::Accel,
    technique::{Touched, TouchedBoxes},
};

/// Cells at most: a bit each.
const CELLS_MAX: u32 = u64::BITS;

/// Room around a box of an edit, in radii of the scene: many times what rounding may move a segment by within the grid.
const ROOM: f32 = 1e-3;

/// A way that rises no more than this for each metre may in truth fall.
const LEVEL: f32 = 1e-5;

/// How far cells lie off the middle of the scene, in cells.
const OFF_MIDDLE: f32 = 0.3;

/// Cells of about one length that fill the scene's bounds; those at its border go on without end.
#[derive(Clone, Debug)]
pub(super) struct CoarseGrid {
    low: Vec3,
    /// Cells per metre, by axis; 0 along an axis that is not cut.
    per_m: Vec3,
    /// Cells along each axis, less one.
    last: Vec3,
    /// By axis: bits of all cells before each place along it, and behind them of all.
    up_to: [[u64; CELLS_MAX as usize + 1]; 3],
    room_m: f32,
    /// Everything that stood in the scene is nearer to the origin, m.
    end_m: f32,
}

impl Default for CoarseGrid {
    /// One cell without end.
    fn default() -> CoarseGrid {
        let (low, per_m, last) = (Vec3::ZERO, Vec3::ZERO, Vec3::ZERO);
        CoarseGrid { low, per_m, last, up_to: up_to(IVec3::ONE), room_m: 0.0, end_m: 0.0 }
    }
}

impl CoarseGrid {
    /// Over everything that stands in the scene now; what comes to stand outside is in the cells at the border.
    pub(super) fn over(accel: &Accel) -> CoarseGrid {
        let bounds = accel.instances().iter().map(|i| *i.bounds_in_world()).reduce(|a, b| a.union(&b));
        let Some(bounds) = bounds else { return CoarseGrid::default() };
        let [low, high] = [bounds.min, bounds.max].map(|corner| accel.to_render(corner));
        let size = high - low;
        // The axis with the longest cells is cut once more, as long as there are bits.
        let mut counts = IVec3::ONE;
        loop {
            let axis = (size / counts.as_vec3()).max_position();
            counts[axis] += 1;
            if counts.element_product() as u32 > CELLS_MAX || !size.is_finite() {
                counts[axis] -= 1;
                break;
            }
        }
        let per_m = counts.as_vec3() / size;
        let per_m = Vec3::select(size.cmpgt(Vec3::ZERO) & per_m.cmplt(Vec3::INFINITY), per_m, Vec3::ZERO);
        // In the middle of a scene much goes on: no corner of cells is to lie there.
        let low = low - OFF_MIDDLE * size / counts.as_vec3();
        CoarseGrid {
            low,
            per_m,
            last: (counts - 1).as_vec3(),
            up_to: up_to(counts),
            room_m: ROOM * accel.radius(),
            end_m: accel.radius(),
        }
    }

    fn at(&self, p: Vec3) -> Vec3 {
        (p - self.low) * self.per_m
    }

    /// Nothing lies below the first cell, so that cutting off is rounding down, which is a call where the processor has no
    /// instruction for it.
    fn cell(&self, at: Vec3) -> IVec3 {
        at.clamp(Vec3::ZERO, self.last).as_ivec3()
    }

    /// Cells of the box between two.
    fn between(&self, a: IVec3, b: IVec3) -> u64 {
        let (low, high) = (a.min(b), a.max(b));
        let along =
            |axis: usize| self.up_to[axis][high[axis] as usize + 1] ^ self.up_to[axis][low[axis] as usize];
        along(0) & along(1) & along(2)
    }

    /// Cells that the segment may pass: those of boxes around its halves. Of an edit in the middle of Sponza a seventh fewer paths would
    /// be asked by going from plane to plane between cells [AmanatidesWoo1987], which is more work for each that is traced.
    pub(super) fn passed(&self, from: Vec3, to: Vec3) -> u64 {
        let (from, to) = (self.at(from), self.at(to));
        // What is nowhere may have been anywhere.
        if !(from + to).is_finite() {
            return u64::MAX;
        }
        let middle = self.cell((from + to) * 0.5);
        self.between(self.cell(from), middle) | self.between(middle, self.cell(to))
    }

    /// Cells of a way from `from` without end.
    ///
    /// - `direction`: unit
    pub(super) fn passed_towards(&self, from: Vec3, direction: Vec3) -> u64 {
        let from_m = from.length();
        // From far outside rounding is no longer small against cells.
        if !(from_m <= 4.0 * self.end_m) {
            return u64::MAX;
        }
        let to = from + direction * (self.end_m + from_m);
        // Cells at the border go on without end, and a way that leaves the scene at a slant passes from one to the next however far
        // out: on from there any between where it is and where it tends to.
        let end = self.cell(self.at(to)).as_vec3();
        let [lowest, highest] = [-direction, direction].map(|way| way.cmpgt(Vec3::splat(-LEVEL)));
        let low = Vec3::select(lowest, Vec3::ZERO, end);
        let high = Vec3::select(highest, self.last, end);
        self.passed(from, to) | self.between(low.as_ivec3(), high.as_ivec3())
    }

    /// Cells that the boxes of an edit touch, or come near to: no segment meets a box that passed none of them.
    pub(super) fn touched(&self, touched: &TouchedBoxes) -> u64 {
        touched.boxes().iter().map(|touched| self.cells_of(touched)).fold(0, |all, cells| all | cells)
    }

    fn cells_of(&self, touched: &Touched) -> u64 {
        let [low, high] = touched.grown(self.room_m).corners().map(|corner| self.cell(self.at(corner)));
        self.between(low, high)
    }
}

/// See [`CoarseGrid::up_to`].
fn up_to(counts: IVec3) -> [[u64; CELLS_MAX as usize + 1]; 3] {
    let mut up_to = [[0; CELLS_MAX as usize + 1]; 3];
    for cell in 0..counts.element_product() {
        let place = IVec3::new(cell % counts.x, cell / counts.x % counts.y, cell / counts.x / counts.y);
        for (axis, up_to) in up_to.iter_mut().enumerate() {
            up_to[place[axis] as usize + 1..].iter_mut().for_each(|bits| *bits |= 1 << cell);
        }
    }
    up_to
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use glam::{DAffine3, DVec3};

    use super::*;
    use crate::{
        math::{Rgb, sobol::point},
        scene::{
            Material,
            samples::{self, Stage},
        },
        transport::World,
    };

    fn grid_over(size: Vec3) -> CoarseGrid {
        let scene = samples::cornell_box().expect("a scene");
        let world = World::prepare(Arc::new(scene));
        let grid = CoarseGrid::over(world.accel());
        let counts = grid.last + 1.0;
        assert!(counts.element_product() <= 64.0 && counts.element_product() >= 27.0, "{counts}");
        CoarseGrid {
            low: -0.5 * size,
            per_m: counts / size,
            room_m: 1e-3 * size.length(),
            end_m: size.length(),
            ..grid
        }
    }

    /// No segment meets a box without having passed a cell of it: at every scale, within the scene and outside.
    #[test]
    fn what_meets_a_box_passed_a_cell_of_it() {
        for size in [Vec3::ONE, Vec3::new(30.0, 12.0, 0.2), Vec3::new(1e-4, 1e4, 1.0)] {
            let grid = grid_over(size);
            let (mut met, mut skipped) = (0, 0);
            for index in 0..200_000 {
                let [a, b, c, d] = [1u64, 2, 3, 4].map(|key| {
                    let [x, y, z, _] = point(key, index);
                    1.4 * size * (Vec3::new(x, y, z) - 0.5)
                });
                let middle = c;
                let half = 0.05 * d.abs();
                let touched = Touched::between(middle - half, middle + half);
                let has_passed = grid.passed(a, b) & grid.cells_of(&touched) != 0;
                met += u32::from(touched.meets(a, b));
                skipped += u32::from(!has_passed);
                assert!(has_passed || !touched.meets(a, b), "{size} {index}: from {a} to {b}, {touched:?}");
            }
            assert!(met > 100 && skipped > 50_000, "{size}: {met} met, {skipped} skipped");
        }
    }

    /// The same of ways without end, to boxes up to a hundred radii out.
    #[test]
    fn what_leaves_meets_no_box_beyond_the_cells_it_passed() {
        let scene = samples::cornell_box().expect("a scene");
        let world = World::prepare(Arc::new(scene));
        let grid = CoarseGrid::over(world.accel());
        let radius = world.accel().radius();
        let (mut met, mut skipped) = (0, 0);
        for index in 0..200_000 {
            let [from, towards, aside] = [5u64, 6, 7].map(|key| {
                let [x, y, z, _] = point(key, index);
                2.0 * Vec3::new(x, y, z) - 1.0
            });
            let [distance, size, level, _] = point(8, index);
            let mut towards = towards;
            // Every fourth is level, or next to it.
            if level < 0.25 {
                towards[index as usize % 3] *= 1e-6 * (level * 1e3).fract();
            }
            let (from, direction) = (from * radius, towards.normalize());
            let distance_m = radius * 100f32.powf(2.0 * distance - 1.0);
            let half_m = distance_m * 0.3 * size;
            let middle = from + direction * distance_m + aside * half_m * 4.0;
            let touched = Touched::between(middle - half_m, middle + half_m);
            let has_passed = grid.passed_towards(from, direction) & grid.cells_of(&touched) != 0;
            let meets = touched.meets(from, from + direction * 1e3 * radius);
            met += u32::from(meets);
            skipped += u32::from(!has_passed);
            assert!(has_passed || !meets, "{index}: from {from} towards {direction}, {touched:?}");
        }
        assert!(met > 20_000 && skipped > 2_000, "{met} met, {skipped} skipped");
    }

    /// A scene without extent along an axis is cut along the others, one that is empty not at all; what is nowhere may be anywhere.
    #[test]
    fn flat_scenes_have_cells() {
        let mut stage = Stage::default();
        let white = stage.material("white", Material::lambert(Rgb::splat(0.8))).expect("a material");
        let corners = [[0.0, 0.0], [1.0, 0.0], [1.0, 2.0], [0.0, 2.0]].map(|[x, z]| DVec3::new(x, 3.0, z));
        stage.place("floor", samples::quad(corners, &white), DAffine3::IDENTITY).expect("a node");
        let world = World::prepare(Arc::new(stage.finish()));
        let grid = CoarseGrid::over(world.accel());
        assert!(grid.last.y == 0.0 && grid.last.x >= 4.0 && grid.last.z >= 8.0, "{grid:?}");
        let corner = |x: f64, z: f64| world.accel().to_render(DVec3::new(x, 3.0, z));
        let near = Touched::between(corner(0.8, 0.1), corner(0.9, 0.2));
        let passed = grid.passed(corner(0.1, 0.1), corner(0.1, 1.9));
        assert!(passed != 0 && passed & grid.cells_of(&near) == 0);
        let empty = CoarseGrid::default();
        for grid in [&grid, &empty] {
            assert_eq!(grid.passed(Vec3::NAN, Vec3::ONE), u64::MAX);
            assert_eq!(grid.passed(Vec3::ONE, Vec3::splat(f32::INFINITY)), u64::MAX);
            assert_eq!(grid.passed_towards(Vec3::splat(f32::NAN), Vec3::Y), u64::MAX);
        }
        assert_eq!(empty.passed(Vec3::ZERO, Vec3::ONE), 1);
        assert_eq!(empty.cells_of(&Touched::between(-Vec3::ONE, Vec3::ONE)), 1);
    }
}
