//! What the cells of the cube cut off the triangles of an instance.

use std::{f32::consts::SQRT_2, sync::Arc};

use glam::{UVec3, Vec3};
use rayon::prelude::*;

use super::{cube::Cube, voxels::morton};
use crate::{
    accel::Instance,
    technique::{PartVisitor, PlacedPart, Surfaces, clip_to_box},
};

/// Layers that a cell is cut into for telling sheets apart.
const LAYERS: f32 = 4.0;

/// What one surface of an instance has in one cell, facing about one way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Piece {
    pub(super) code: u32,
    /// Number within the instance.
    pub(super) surface: u32,
    /// Which of the six axes it faces most.
    pub(super) axis: u8,
    /// In which layer of the cell along that axis its triangles' parts have their middles.
    pub(super) layer: u8,
    pub(super) area_m2: f32,
    /// Sums by area.
    pub(super) centre: Vec3,
    pub(super) normal: Vec3,
}

impl Piece {
    /// Of one name an instance has one piece.
    fn name(&self) -> (u32, u32, u8, u8) {
        (self.code, self.surface, self.axis, self.layer)
    }

    /// Adds another of the same name; false for one of another.
    fn takes_in(&mut self, other: &Piece) -> bool {
        let is_same = self.name() == other.name();
        if is_same {
            self.area_m2 += other.area_m2;
            self.centre += other.centre;
            self.normal += other.normal;
        }
        is_same
    }
}

/// The pieces of an instance, which stay as long as it is not touched.
#[derive(Debug)]
pub(super) struct InstancePieces {
    pub(super) instance: Arc<Instance>,
    pub(super) pieces: Vec<Piece>,
}

/// Cuts the triangles of an instance by the cells.
pub(super) fn pieces_of(
    instance: &Arc<Instance>,
    index: u32,
    surfaces: &Surfaces,
    cube: &Cube,
) -> InstancePieces {
    let of_work = |work: (u32, usize)| {
        let mut cut = Cut { cube, instance, surface: work.0, pieces: Vec::new() };
        surfaces.visit(index, work, &mut cut);
        cut.pieces
    };
    let work = surfaces.pieces_of_work(index);
    let mut pieces: Vec<Piece> = work.into_par_iter().flat_map_iter(of_work).collect();
    // By name, then as they came: sums are added up in the order of the surfaces' parts.
    pieces.sort_by_key(Piece::name);
    pieces.dedup_by(|next, kept| kept.takes_in(next));
    InstancePieces { instance: instance.clone(), pieces }
}

struct Face {
    corners: [Vec3; 3],
    n: Vec3,
}

/// The pieces that a surface is cut into.
struct Cut<'a> {
    cube: &'a Cube,
    instance: &'a Instance,
    surface: u32,
    pieces: Vec<Piece>,
}

impl PartVisitor for Cut<'_> {
    /// What lies in one layer of one leaf and faces one axis is one piece: most of what is finely tessellated.
    fn takes(&mut self, part: &PlacedPart<'_>) -> bool {
        let (middle, reach_m) = part.ball();
        let (cell, level) = self.cube.around_all([middle - reach_m, middle, middle + reach_m]);
        if level < self.cube.depth {
            return false;
        }
        let (facing, chord) = part.facing();
        let axis = axis_of(facing);
        let along = usize::from(axis / 2);
        let size = facing.abs();
        let others = size[(along + 1) % 3].max(size[(along + 2) % 3]);
        let is_of_axis = size[along] - others > SQRT_2 * chord && size[along] > chord;
        let [first, last] =
            [middle[along] - reach_m, middle[along] + reach_m].map(|at| self.layer_of(cell, along, at));
        if !(is_of_axis && first == last) {
            return false;
        }
        let (area_m2, [centre, normal]) = part.sums();
        if !(area_m2 > 0.0) {
            return false;
        }
        self.add(Piece {
            code: morton(cell),
            surface: self.surface,
            axis,
            layer: first,
            area_m2,
            centre,
            normal,
        });
        true
    }

    fn triangle(&mut self, triangle: u32) {
        let instance = self.instance;
        let corners =
            instance.mesh().triangles()[triangle as usize].map(|vertex| instance.vertex_in_render(vertex));
        let [a, b, c] = corners;
        let n = ((b - a).cross(c - a) * instance.handedness()).normalize_or_zero();
        if n != Vec3::ZERO {
            let (cell, level) = self.cube.around_all(corners);
            let face = Face { corners, n };
            // What is surely in one leaf need not be asked whether it meets it.
            if level == self.cube.depth { self.leaf(&face, cell) } else { self.cut(&face, cell, level) }
        }
    }
}

impl Cut<'_> {
    /// Layer of a leaf along an axis that a place lies in.
    fn layer_of(&self, cell: UVec3, along: usize, at: f32) -> u8 {
        let [low, _] = self.cube.corners(cell, self.cube.depth);
        let layer = (at - low[along]) / self.cube.size_of(cell)[along] * LAYERS;
        layer.clamp(0.0, LAYERS - 1.0) as u8
    }

    fn add(&mut self, piece: Piece) {
        // Neighbours mostly have one name: fewer are left to sort.
        if !self.pieces.last_mut().is_some_and(|last| last.takes_in(&piece)) {
            self.pieces.push(piece);
        }
    }

    /// Follows the face down to the leaves.
    fn cut(&mut self, face: &Face, cell: UVec3, level: u32) {
        let [low, high] = self.cube.corners(cell, level);
        if !may_meet(face, low, high) {
            return;
        }
        if level < self.cube.depth {
            for child in 0..8u32 {
                let offset = UVec3::new(child & 1, child >> 1 & 1, child >> 2);
                self.cut(face, cell * 2 + offset, level + 1);
            }
            return;
        }
        self.leaf(face, cell);
    }

    /// Adds what a leaf holds of the face.
    fn leaf(&mut self, face: &Face, cell: UVec3) {
        let [low, high] = self.cube.corners(cell, self.cube.depth);
        let Some(patch) = clip_to_box(face.corners, low, high) else { return };
        if patch.area_m2 > 0.0 {
            let axis = axis_of(face.n);
            let along = usize::from(axis / 2);
            self.add(Piece {
                code: morton(cell),
                surface: self.surface,
                axis,
                layer: self.layer_of(cell, along, patch.centroid[along]),
                area_m2: patch.area_m2,
                centre: patch.centroid * patch.area_m2,
                normal: face.n * patch.area_m2,
            });
        }
    }
}

/// False when the face surely misses the box: by its bounds or by its plane.
fn may_meet(face: &Face, low: Vec3, high: Vec3) -> bool {
    let [a, b, c] = face.corners;
    let slack = Cube::slack(low, high - low);
    let (low, high) = (low - slack, high + slack);
    let apart = a.min(b).min(c).cmpgt(high) | a.max(b).max(c).cmplt(low);
    let middle = (low + high) * 0.5;
    let reach = face.n.abs().dot((high - low) * 0.5);
    !apart.any() && (face.n.dot(middle - a)).abs() <= reach
}

/// Which of the six axes a direction follows most: twice the axis, and one more where it goes the other way.
pub(super) fn axis_of(n: Vec3) -> u8 {
    let size = n.abs();
    let axis = if size.x >= size.y && size.x >= size.z {
        0
    } else if size.y >= size.z {
        1
    } else {
        2
    };
    2 * axis + u8::from(n[usize::from(axis)] < 0.0)
}

#[cfg(test)]
mod tests {
    use glam::{DAffine3, DQuat, DVec3};

    use super::super::cube::tests::cube;
    use super::*;
    use crate::{
        math::{Rgb, sobol::point},
        scene::{
            Material,
            samples::{self, Stage},
        },
        technique::CREASE_ANGLE_RAD,
        transport::World,
    };

    /// A ball of so many rings and 0.3 m, and a box, turned and mirrored.
    fn world(rings: u32) -> World {
        let mut stage = Stage::default();
        let white = stage.material("white", Material::lambert(Rgb::splat(0.5))).unwrap();
        let turn = DQuat::from_scaled_axis(DVec3::new(0.3, 1.2, -0.4));
        let at = DAffine3::from_scale_rotation_translation(DVec3::new(-0.3, 0.3, 0.3), turn, DVec3::ZERO);
        stage.place("ball", samples::sphere(DVec3::ZERO, 1.0, rings, &white), at).unwrap();
        stage.place("box", samples::cuboid(DVec3::splat(-0.7), DVec3::splat(0.2), &white), at).unwrap();
        World::prepare(Arc::new(stage.finish()))
    }

    /// What it takes together, and what is left.
    struct Counted<'a> {
        cut: Cut<'a>,
        taken: usize,
        alone: usize,
    }

    impl PartVisitor for Counted<'_> {
        fn takes(&mut self, part: &PlacedPart<'_>) -> bool {
            let takes = self.cut.takes(part);
            self.taken += usize::from(takes);
            takes
        }

        fn triangle(&mut self, _: u32) {
            self.alone += 1;
        }
    }

    /// What is taken together leaves the pieces that its triangles leave one by one.
    #[test]
    fn parts_leave_the_pieces_of_their_triangles() {
        let world = world(40);
        let accel = world.accel();
        let surfaces = Surfaces::of(accel, CREASE_ANGLE_RAD, &Surfaces::default());
        let (mut taken, mut alone) = (0, 0);
        for (low, depth) in
            [(Vec3::splat(-0.5), 1), (Vec3::new(-0.5, -0.53, -0.47), 3), (Vec3::splat(-0.5), 6)]
        {
            let cube = cube(low, depth, 1);
            for (index, instance) in (0u32..).zip(accel.instances()) {
                let together = pieces_of(instance, index, &surfaces, &cube).pieces;
                let mut one_by_one = Vec::new();
                for triangle in 0..instance.mesh().triangles().len() as u32 {
                    let surface = surfaces.surface_in_instance(index, triangle);
                    let mut cut = Cut { cube: &cube, instance, surface, pieces: Vec::new() };
                    cut.triangle(triangle);
                    one_by_one.append(&mut cut.pieces);
                }
                let mut counted = Counted {
                    cut: Cut { cube: &cube, instance, surface: 0, pieces: Vec::new() },
                    taken: 0,
                    alone: 0,
                };
                let work = surfaces.pieces_of_work(index);
                work.into_iter().for_each(|work| surfaces.visit(index, work, &mut counted));
                taken += counted.taken;
                alone += counted.alone;
                one_by_one.sort_by_key(Piece::name);
                one_by_one.dedup_by(|next, kept| kept.takes_in(next));
                assert_eq!(together.len(), one_by_one.len());
                for (a, b) in together.iter().zip(&one_by_one) {
                    assert_eq!(a.name(), b.name());
                    assert!((a.area_m2 / b.area_m2 - 1.0).abs() < 1e-3, "{a:?} for {b:?}");
                    assert!(a.centre.distance(b.centre) < 1e-3 * b.area_m2, "{a:?} for {b:?}");
                    assert!(a.normal.distance(b.normal) < 1e-3 * b.area_m2, "{a:?} for {b:?}");
                }
            }
        }
        assert!(taken > 100 && alone > 100, "{taken} parts, {alone} triangles");
    }

    /// Followed down from the smallest cell that holds it a triangle leaves the pieces that it leaves from the top, wherever the cube
    /// lies, also where corners lie in planes between cells.
    #[test]
    fn triangles_leave_the_same_pieces_from_their_own_cell_on() {
        let (mut small_count, mut nested_count) = (0, 0);
        let world = world(4);
        let instance = &world.accel().instances()[0];
        for (index, low) in (0..6000u32).zip([0.0, -0.5, 1e3, -3e4, -30.3].into_iter().cycle()) {
            let cube = cube(Vec3::splat(low), 5, index / 5);
            let [x, y, z, size] = point(1, index);
            // Onto corners of cells.
            let snap = |p: Vec3| match index % 3 {
                0 => {
                    let [x, y, z] = cube.place_of(p).round().as_uvec3().to_array().map(|cell| cell.min(31));
                    let plane = |cell: u32| cube.corners(UVec3::splat(cell), cube.depth)[0];
                    Vec3::new(plane(x).x, plane(y).y, plane(z).z)
                }
                _ => p,
            };
            let middle = Vec3::new(x, y, z);
            let corners = [2u64, 3, 4].map(|key| {
                let [x, y, z, _] = point(key, index);
                let from_middle = (Vec3::new(x, y, z) - 0.5) * size.powi(4);
                snap(cube.low + (middle + from_middle).clamp(Vec3::ZERO, Vec3::splat(0.95)))
            });
            let [a, b, c] = corners;
            let n = (b - a).cross(c - a).normalize_or_zero();
            let face = Face { corners, n };
            let pieces_from = |cell: UVec3, level: u32| {
                let mut cut = Cut { cube: &cube, instance, surface: 0, pieces: Vec::new() };
                cut.cut(&face, cell, level);
                cut.pieces
            };
            let (cell, level) = cube.around_all(corners);
            small_count += u32::from(level == cube.depth);
            nested_count += u32::from(cube.nested.is_some() && low < -1.0 && level == cube.depth);
            assert_eq!(pieces_from(cell, level), pieces_from(UVec3::ZERO, 0), "{index}: {corners:?}");
        }
        assert!(small_count > 400 && nested_count > 30, "{small_count} {nested_count}");
    }
}
