//! Which cells of the cube hold which surfaces: the geometry of the octree, without light.
//!
//! Every triangle is cut by the cells; what lies in one cell is grouped by where it faces and by the plane it lies in, for
//! each side of the surface by itself: surfaces that face apart, or lie one above the other, get different light.

use std::{
    collections::{HashMap, HashSet},
    ops::Range,
    sync::Arc,
};

use glam::{IVec3, UVec3, Vec3};
use rayon::prelude::*;

use super::{OctreeSettings, cube::Cube};
use crate::{
    accel::{Accel, Instance},
    technique::{SideId, Surfaces, clip_to_box},
};

/// Triangles that are cut as one piece of work.
const CHUNK: usize = 2048;
/// Instances that changed at once, of which each is looked at by itself.
const MOVED_MAX: usize = 64;
/// Groups of a cell at most: two sheets for each direction of space.
const SETS_MAX: usize = 12;
/// How far from a group's mean plane a surface joins it, in sides of a cell: beyond it is another sheet.
const SHEET_JOINS_CELLS: f32 = 0.25;
/// Layers that a cell is cut into for telling sheets apart.
const LAYERS: f32 = 4.0;
/// A cell holds one plane where the mean of its normals is so long …
const FLAT_COS: f32 = 0.99;
/// … and its groups lie no farther from each other, in sides of a cell.
const FLAT_CELLS: f32 = 0.02;
/// Where wide ground lies around things, of so many photons that are aimed at them one is expected where somebody looks: most fall on roofs and
/// on the ground before them, and windows let few in. With 1, a room with a window lit by the sky was 25 % off for 18.
const OUTDOORS: u32 = 9;
/// Cosine of the angle from a group's mean normal within which a surface joins it.
const JOINS_COS: f32 = 0.5;

/// The place of a cell along the curve that visits the octree's leaves in order.
pub(super) fn morton(cell: UVec3) -> u32 {
    fn spread(mut x: u32) -> u32 {
        x = (x | x << 16) & 0x0300_00ff;
        x = (x | x << 8) & 0x0300_f00f;
        x = (x | x << 4) & 0x030c_30c3;
        (x | x << 2) & 0x0924_9249
    }
    spread(cell.x) | spread(cell.y) << 1 | spread(cell.z) << 2
}

/// The cell of a Morton code.
pub(super) fn cell_of(code: u32) -> UVec3 {
    fn gather(mut x: u32) -> u32 {
        x &= 0x0924_9249;
        x = (x | x >> 2) & 0x030c_30c3;
        x = (x | x >> 4) & 0x0300_f00f;
        x = (x | x >> 8) & 0x0300_00ff;
        (x | x >> 16) & 0x0000_03ff
    }
    UVec3::new(gather(code), gather(code >> 1), gather(code >> 2))
}

/// How many photons there are, and how many a gather asks for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Expected {
    pub(super) photon_count: u32,
    pub(super) gathered_count: usize,
}

impl Expected {
    pub(super) fn by(settings: &OctreeSettings, cube: &Cube) -> Expected {
        let outdoors = if cube.nested.is_some() { OUTDOORS } else { 1 };
        let photon_count = settings.photon_count / outdoors;
        Expected { photon_count, gathered_count: settings.neighbours_min.get() }
    }

    /// Area that catches the photons of a gather if all lie evenly on `area_m2`; in steps of 2^¼, so that small edits leave
    /// it, m².
    pub(super) fn area_of_a_gather_m2(self, area_m2: f64) -> f64 {
        let even = self.gathered_count as f64 * area_m2 / f64::from(self.photon_count.max(1));
        ((4.0 * even.log2()).round() / 4.0).exp2()
    }
}

/// What one surface of an instance has in one cell, facing about one way.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Piece {
    code: u32,
    /// Number within the instance.
    surface: u32,
    /// Which of the six axes it faces most.
    axis: u8,
    /// In which layer of the cell along that axis its triangles' parts have their middles.
    layer: u8,
    area_m2: f32,
    /// Sums by area.
    centre: Vec3,
    normal: Vec3,
}

/// The pieces of an instance, which stay as long as it is not touched.
#[derive(Debug)]
struct InstancePieces {
    instance: Arc<Instance>,
    pieces: Vec<Piece>,
}

/// Surfaces of a cell that face about one way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct VoxelSet {
    /// Mean normal, unit.
    pub(super) normal: Vec3,
    /// Mean position.
    pub(super) centre: Vec3,
    pub(super) area_m2: f32,
    /// The largest side of its cell over that of cells that are all as large.
    pub(super) scale: f32,
    /// Side of its cell along the axis that it faces most, m.
    pub(super) across_m: f32,
    /// It is one plane, and nothing in its cell or those around faces another way or lies elsewhere.
    pub(super) is_alone: bool,
    /// Its sides, in [`Voxels::sides`].
    pub(super) first_side: u32,
    pub(super) side_count: u32,
}

/// The cells that hold surface, in Morton order.
#[derive(Debug)]
pub(super) struct Voxels {
    pub(super) cube: Cube,
    instances: Vec<Arc<InstancePieces>>,
    pub(super) codes: Vec<u32>,
    /// `[cells + 1]`: where each cell's groups start.
    pub(super) first_set: Vec<u32>,
    pub(super) sets: Vec<VoxelSet>,
    pub(super) sides: Vec<SideId>,
    /// Of everything, one side, as if all of it lay in cells that are all as large.
    pub(super) area_m2: f64,
}

impl Voxels {
    /// Of a scene; pieces of instances that stayed are taken from `before`.
    pub(super) fn of(
        accel: &Accel,
        surfaces: &Surfaces,
        cube: Cube,
        expected: Expected,
        before: Option<&Voxels>,
    ) -> Voxels {
        // Addresses name instances: both sides hold them, so none can be another's.
        let address = |instance: &Arc<Instance>| Arc::as_ptr(instance).addr();
        let known: HashMap<usize, &Arc<InstancePieces>> = before
            .filter(|before| before.cube == cube)
            .map(|before| before.instances.iter().map(|known| (address(&known.instance), known)).collect())
            .unwrap_or_default();
        let instances: Vec<Arc<InstancePieces>> = accel
            .instances()
            .par_iter()
            .enumerate()
            .map(|(index, instance)| match known.get(&address(instance)) {
                Some(known) => Arc::clone(known),
                None => Arc::new(pieces_of(instance, index as u32, surfaces, &cube)),
            })
            .collect();
        let mut voxels = Voxels {
            cube,
            instances,
            codes: Vec::new(),
            first_set: vec![0],
            sets: Vec::new(),
            sides: Vec::new(),
            area_m2: 0.0,
        };
        voxels.group(surfaces);
        voxels.tell_from_alone();
        voxels.join_small(surfaces, expected);
        voxels
    }

    /// Gives groups of surfaces that are too small to catch enough photons the sides of the groups around that face like
    /// them: one photon on a leaf the size of a coin says nothing.
    fn join_small(&mut self, surfaces: &Surfaces, expected: Expected) {
        let small_m2 = expected.area_of_a_gather_m2(self.area_m2) as f32;
        let is_small = |set: &VoxelSet| {
            let area = |side: &SideId| surfaces.area_m2(side.surface());
            self.sides_of(set).iter().map(area).sum::<f32>() < small_m2 * set.scale * set.scale
        };
        let joined: Vec<Option<Vec<SideId>>> = (0..self.codes.len())
            .into_par_iter()
            .flat_map_iter(|cell| {
                let around = self.sets_of(cell).iter().any(is_small).then(|| self.cells_around(cell));
                let this = &*self;
                this.sets_of(cell).iter().map(move |set| {
                    let around = around.as_ref().filter(|_| is_small(set))?;
                    let alike = around
                        .iter()
                        .flat_map(|cell| this.sets_of(*cell))
                        .filter(|other| other.normal.dot(set.normal) >= JOINS_COS)
                        .flat_map(|other| this.sides_of(other));
                    let mut sides: Vec<SideId> = alike.chain(this.sides_of(set)).copied().collect();
                    sides.sort_unstable();
                    sides.dedup();
                    Some(sides)
                })
            })
            .collect();
        for (set, sides) in self.sets.iter_mut().zip(joined) {
            let Some(mut sides) = sides else { continue };
            set.first_side = self.sides.len() as u32;
            set.side_count = sides.len() as u32;
            self.sides.append(&mut sides);
        }
    }

    /// Groups beside which something else lies in a cell nearby are not alone.
    fn tell_from_alone(&mut self) {
        let is_alone: Vec<bool> = (0..self.codes.len())
            .into_par_iter()
            .map(|cell| {
                let sets = self.sets_of(cell);
                let is_like = |other: &VoxelSet| {
                    let off_m = sets[0].normal.dot(other.centre - sets[0].centre).abs();
                    other.is_alone
                        && sets[0].normal.dot(other.normal).abs() >= FLAT_COS
                        && off_m <= FLAT_CELLS * sets[0].across_m
                };
                let around = || self.cells_around(cell);
                sets[0].is_alone && around().into_iter().flat_map(|cell| self.sets_of(cell)).all(is_like)
            })
            .collect();
        for (cell, is_alone) in is_alone.into_iter().enumerate() {
            let places = self.places_of(cell);
            self.sets[places].iter_mut().for_each(|set| set.is_alone = is_alone);
        }
    }

    /// The cells around one that hold surface, by their places.
    pub(super) fn cells_around(&self, cell: usize) -> Vec<usize> {
        let middle = cell_of(self.codes[cell]).as_ivec3();
        let last = self.cube.cells() as i32 - 1;
        let mut around = Vec::new();
        for offset in 0..27 {
            let at = middle + IVec3::new(offset % 3, offset / 3 % 3, offset / 9) - 1;
            if at != middle && at.cmpge(IVec3::ZERO).all() && at.cmple(IVec3::splat(last)).all() {
                around.extend(self.codes.binary_search(&morton(at.as_uvec3())));
            }
        }
        around
    }

    fn group(&mut self, surfaces: &Surfaces) {
        let mut all: Vec<(u32, u32, Piece)> = (0u32..)
            .zip(&self.instances)
            .flat_map(|(instance, pieces)| {
                let first = surfaces.first_surface(instance);
                pieces.pieces.iter().map(move |piece| (piece.code, first + piece.surface, *piece))
            })
            .collect();
        self.area_m2 = all.iter().map(|(_, _, piece)| self.area_in_even_cells_m2(piece)).sum();
        all.par_sort_unstable_by_key(|(code, surface, piece)| (*code, *surface, piece.axis, piece.layer));
        for cell in all.chunk_by(|a, b| a.0 == b.0) {
            self.codes.push(cell[0].0);
            self.add_sets(cell);
            self.first_set.push(self.sets.len() as u32);
        }
    }

    /// How much of a piece there would be, as many photons as it gets, were all cells as large.
    fn area_in_even_cells_m2(&self, piece: &Piece) -> f64 {
        let area_m2 = f64::from(piece.area_m2);
        match &self.cube.nested {
            None => area_m2,
            Some(_) => area_m2 / f64::from(self.cube.scale_of(cell_of(piece.code))).powi(2),
        }
    }

    /// Groups the pieces of one cell, largest first.
    fn add_sets(&mut self, cell: &[(u32, u32, Piece)]) {
        let mut order: Vec<(usize, bool)> =
            (0..cell.len()).flat_map(|index| [(index, true), (index, false)]).collect();
        order.sort_by(|a, b| {
            let area = |index: usize| cell[index].2.area_m2;
            area(b.0).total_cmp(&area(a.0)).then(a.0.cmp(&b.0)).then(b.1.cmp(&a.1))
        });
        let at = cell_of(cell[0].0);
        let size_m = self.cube.size_of(at);
        let mut groups: Vec<Group> = Vec::new();
        for (index, is_front) in order {
            let (_, surface, piece) = &cell[index];
            let side = SideId::of(*surface, is_front);
            let normal = if is_front { piece.normal } else { -piece.normal };
            let likeness = |group: &Group| {
                let n = group.normal.normalize_or_zero();
                let cos = n.dot(normal) / normal.length();
                let apart = n.dot(piece.centre / piece.area_m2 - group.centre / group.area_m2).abs();
                let across_m = across_m(size_m, group.normal);
                let joins = cos >= JOINS_COS && apart <= SHEET_JOINS_CELLS * across_m;
                (joins, cos - apart / across_m)
            };
            let best = groups.iter().enumerate().map(|(place, group)| (place, likeness(group))).max_by(
                |(a_place, a), (b_place, b)| {
                    a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)).then(b_place.cmp(a_place))
                },
            );
            match best {
                Some((place, (joins, _))) if joins || groups.len() == SETS_MAX => {
                    groups[place].add(piece, normal, side);
                }
                _ => {
                    let mut group = Group::default();
                    group.add(piece, normal, side);
                    groups.push(group);
                }
            }
        }
        let is_alone = is_one_plane(&groups, size_m);
        let scale = self.cube.scale_of(at);
        for mut group in groups {
            group.sides.sort_unstable();
            group.sides.dedup();
            let normal = group.normal.normalize_or(Vec3::Z);
            self.sets.push(VoxelSet {
                normal,
                centre: group.centre / group.area_m2,
                area_m2: group.area_m2,
                scale,
                across_m: across_m(size_m, normal),
                is_alone,
                first_side: self.sides.len() as u32,
                side_count: group.sides.len() as u32,
            });
            self.sides.append(&mut group.sides);
        }
    }

    /// Boxes around the instances that these or the ones before have and the others have not, `[low, high]` in render space; one
    /// box around all of many.
    pub(super) fn moved_since(&self, before: &Voxels, accel: &Accel) -> Vec<[Vec3; 2]> {
        let address = |pieces: &Arc<InstancePieces>| Arc::as_ptr(&pieces.instance).addr();
        let [now, then] = [self, before].map(|v| v.instances.iter().map(address).collect::<HashSet<usize>>());
        let came = self.instances.iter().filter(|pieces| !then.contains(&address(pieces)));
        let went = before.instances.iter().filter(|pieces| !now.contains(&address(pieces)));
        let boxes: Vec<[Vec3; 2]> = came
            .chain(went)
            .map(|pieces| pieces.instance.bounds_in_world())
            .map(|bounds| [bounds.min, bounds.max].map(|corner| accel.to_render(corner)))
            .collect();
        if boxes.len() <= MOVED_MAX {
            return boxes;
        }
        let around = |[a, b]: [Vec3; 2], [c, d]: [Vec3; 2]| [a.min(c), b.max(d)];
        boxes.into_iter().reduce(around).into_iter().collect()
    }

    /// Memory.
    pub(super) fn bytes(&self) -> usize {
        let pieces: usize = self.instances.iter().map(|instance| instance.pieces.len()).sum();
        pieces * size_of::<Piece>()
            + (self.codes.len() + self.first_set.len()) * size_of::<u32>()
            + self.sets.len() * size_of::<VoxelSet>()
            + self.sides.len() * size_of::<SideId>()
    }

    /// Places of the groups of a cell, by its place.
    pub(super) fn places_of(&self, cell: usize) -> Range<usize> {
        self.first_set[cell] as usize..self.first_set[cell + 1] as usize
    }

    /// The groups of a cell, by its place.
    pub(super) fn sets_of(&self, cell: usize) -> &[VoxelSet] {
        &self.sets[self.places_of(cell)]
    }

    /// The sides of a group.
    pub(super) fn sides_of(&self, set: &VoxelSet) -> &[SideId] {
        &self.sides[set.first_side as usize..(set.first_side + set.side_count) as usize]
    }
}

#[derive(Debug, Default)]
struct Group {
    area_m2: f32,
    centre: Vec3,
    normal: Vec3,
    sides: Vec<SideId>,
}

impl Group {
    fn add(&mut self, piece: &Piece, normal: Vec3, side: SideId) {
        self.area_m2 += piece.area_m2;
        self.centre += piece.centre;
        self.normal += normal;
        self.sides.push(side);
    }
}

/// All groups of a cell are the two sides of one flat sheet.
fn is_one_plane(groups: &[Group], size_m: Vec3) -> bool {
    let Some(first) = groups.first() else { return true };
    let n = first.normal.normalize_or_zero();
    let across_m = across_m(size_m, n);
    groups.iter().all(|group| {
        let off_m = n.dot(group.centre / group.area_m2 - first.centre / first.area_m2).abs();
        n.dot(group.normal).abs() >= FLAT_COS * group.area_m2 && off_m <= FLAT_CELLS * across_m
    })
}

/// Cuts the triangles of an instance by the cells.
fn pieces_of(instance: &Arc<Instance>, index: u32, surfaces: &Surfaces, cube: &Cube) -> InstancePieces {
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
                cut.cut(&Face { corners, n, surface }, cell, level);
            }
        }
        cut.pieces
    };
    let mut pieces: Vec<Piece> =
        (0..count.div_ceil(CHUNK)).into_par_iter().flat_map_iter(|chunk| of_chunk(chunk * CHUNK)).collect();
    // By name, then as they came: sums are added up in the order of triangles.
    pieces.sort_by_key(|piece| (piece.code, piece.surface, piece.axis, piece.layer));
    pieces.dedup_by(|next, kept| {
        let name = |piece: &Piece| (piece.code, piece.surface, piece.axis, piece.layer);
        let same = name(next) == name(kept);
        if same {
            kept.area_m2 += next.area_m2;
            kept.centre += next.centre;
            kept.normal += next.normal;
        }
        same
    });
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
        let Some(patch) = clip_to_box(face.corners, low, high) else { return };
        if patch.area_m2 > 0.0 {
            let axis = axis_of(face.n);
            let along = usize::from(axis / 2);
            let layer = (patch.centroid[along] - low[along]) / self.cube.size_of(cell)[along] * LAYERS;
            self.pieces.push(Piece {
                code: morton(cell),
                surface: face.surface,
                axis,
                layer: layer.clamp(0.0, LAYERS - 1.0) as u8,
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

/// Side of a cell along the axis that `n` faces most.
pub(super) fn across_m(size_m: Vec3, n: Vec3) -> f32 {
    size_m[usize::from(axis_of(n) / 2)]
}

fn axis_of(n: Vec3) -> u8 {
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
