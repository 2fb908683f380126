//! What the cells of the cube cut off the triangles of an instance.

use std::sync::Arc;

use glam::{UVec3, Vec3};
use rayon::prelude::*;

use super::{cube::Cube, voxels::morton};
use crate::{
    accel::Instance,
    technique::{Surfaces, clip_to_box},
};

/// Triangles that are cut as one piece of work.
const CHUNK: usize = 2048;
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
    let count = instance.mesh().triangles().len();
    let of_chunk = |first: usize| {
        let mut cut = Cut { cube, pieces: Vec::new() };
        for triangle in first..(first + CHUNK).min(count) {
            let corners = instance.mesh().triangles()[triangle].map(|v| instance.vertex_in_render(v));
            let [a, b, c] = corners;
            let n = ((b - a).cross(c - a) * instance.handedness()).normalize_or_zero();
            if n != Vec3::ZERO {
                let surface = surfaces.surface_in_instance(index, triangle as u32);
                let (cell, level) = cube.around_all(corners);
                let face = Face { corners, n, surface };
                // What is surely in one leaf need not be asked whether it meets it.
                if level == cube.depth { cut.leaf(&face, cell) } else { cut.cut(&face, cell, level) }
            }
        }
        cut.pieces
    };
    let mut pieces: Vec<Piece> =
        (0..count.div_ceil(CHUNK)).into_par_iter().flat_map_iter(|chunk| of_chunk(chunk * CHUNK)).collect();
    // By name, then as they came: sums are added up in the order of triangles.
    pieces.sort_by_key(Piece::name);
    pieces.dedup_by(|next, kept| kept.takes_in(next));
    InstancePieces { instance: instance.clone(), pieces }
}

struct Face {
    corners: [Vec3; 3],
    n: Vec3,
    surface: u32,
}

struct Cut<'a> {
    cube: &'a Cube,
    pieces: Vec<Piece>,
}

impl Cut<'_> {
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
            let layer = (patch.centroid[along] - low[along]) / self.cube.size_of(cell)[along] * LAYERS;
            let piece = Piece {
                code: morton(cell),
                surface: face.surface,
                axis,
                layer: layer.clamp(0.0, LAYERS - 1.0) as u8,
                area_m2: patch.area_m2,
                centre: patch.centroid * patch.area_m2,
                normal: face.n * patch.area_m2,
            };
            // Neighbours mostly have one name: a seat of 1,920 triangles leaves a tenth as many to sort.
            if !self.pieces.last_mut().is_some_and(|last| last.takes_in(&piece)) {
                self.pieces.push(piece);
            }
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
    use super::super::cube::tests::cube;
    use super::*;
    use crate::math::sobol::point;

    /// Followed down from the smallest cell that holds it a triangle leaves the pieces that it leaves from the top, wherever the cube
    /// lies, also where corners lie in planes between cells.
    #[test]
    fn triangles_leave_the_same_pieces_from_their_own_cell_on() {
        let (mut small_count, mut nested_count) = (0, 0);
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
            let face = Face { corners, n, surface: 0 };
            let pieces_from = |cell: UVec3, level: u32| {
                let mut cut = Cut { cube: &cube, pieces: Vec::new() };
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
