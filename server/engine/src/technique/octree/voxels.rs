//! Which cells of the cube hold which surfaces: the geometry of the octree, without light.
//!
//! What the cells cut off the triangles (`pieces.rs`) is grouped, in each cell, by where it faces and by the plane it lies in, for
//! each side of the surface by itself: surfaces that face apart, or lie one above the other, get different light.

use std::{
    collections::{HashMap, HashSet},
    ops::Range,
    sync::Arc,
};

use glam::{IVec3, UVec3, Vec3};
use rayon::prelude::*;

use super::{
    OctreeSettings,
    cube::Cube,
    pieces::{InstancePieces, Piece, axis_of, pieces_of},
};
use crate::{
    accel::{Accel, Instance},
    technique::{SideId, Surfaces},
};

/// Instances that changed at once, of which each is looked at by itself.
const MOVED_MAX: usize = 64;
/// Groups of a cell at most: two sheets for each direction of space.
const SETS_MAX: usize = 12;
const _: () = assert!(SETS_MAX <= u16::BITS as usize);
/// How far from a group's mean plane a surface joins it, in sides of a cell: beyond it is another sheet.
const SHEET_JOINS_CELLS: f32 = 0.25;
/// Of two sheets that one group could hold, one lies beyond a body if the far face of that, of so large a share of the larger's area, lies
/// between them (less than half, since a group may hold the back of a wall's far face beside its near one; with half a room in a shell kept a
/// twentieth of what leaked) …
const BETWEEN_SHARE: f32 = 0.4;
/// … and so far from both, in sides of a cell: what touches either is not between.
const BETWEEN_CELLS: f32 = 1e-3;
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
                    // The far inside of a lamp's shade faces as its near outside does.
                    let own = this.sides_of(set);
                    let others = alike.filter(|side| own.binary_search(&side.other()).is_err());
                    let mut sides: Vec<SideId> = others.chain(own).copied().collect();
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
        let largest_first: Vec<&Piece> =
            order.iter().filter(|(_, is_front)| *is_front).map(|(index, _)| &cell[*index].2).collect();
        let at = cell_of(cell[0].0);
        let size_m = self.cube.size_of(at);
        let mut groups: Vec<Group> = Vec::new();
        // Pieces of one surface lie beside each other.
        let surface_of: Vec<usize> = cell
            .iter()
            .scan((0, cell[0].1), |(count, before), (_, surface, _)| {
                *count += usize::from(std::mem::replace(before, *surface) != *surface);
                Some(*count)
            })
            .collect();
        // Of each surface which groups hold its front and its back, a bit for each.
        let mut held = vec![[0u16; 2]; cell.len()];
        for (index, is_front) in order {
            let (_, surface, piece) = &cell[index];
            let side = SideId::of(*surface, is_front);
            let other_held = held[surface_of[index]][usize::from(is_front)];
            let normal = if is_front { piece.normal } else { -piece.normal };
            let likeness = |(place, group): (usize, &Group)| {
                let n = group.normal.normalize_or_zero();
                let cos = n.dot(normal) / normal.length();
                let apart = n.dot(piece.centre / piece.area_m2 - group.centre / group.area_m2).abs();
                let across_m = across_m(size_m, group.normal);
                let is_other_held = other_held & 1 << place != 0;
                let joins = cos >= JOINS_COS
                    && !is_other_held
                    && apart <= SHEET_JOINS_CELLS * across_m
                    && !(is_front
                        && has_body_between(&largest_first, piece, group, BETWEEN_CELLS * across_m));
                // A full cell rather takes what faces alike and holds nothing of the other side.
                ((joins, !is_other_held && cos >= JOINS_COS), cos - apart / across_m)
            };
            let best = groups.iter().enumerate().map(|of| (of.0, likeness(of))).max_by(
                |(a_place, a), (b_place, b)| {
                    a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)).then(b_place.cmp(a_place))
                },
            );
            let place = match best {
                Some((place, ((joins, _), _))) if joins || groups.len() == SETS_MAX => place,
                _ => {
                    groups.push(Group::default());
                    groups.len() - 1
                }
            };
            groups[place].add(piece, normal, side);
            held[surface_of[index]][usize::from(!is_front)] |= 1 << place;
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

/// Between a face and a group that it faces like lies the far face of a body, which keeps the light of the one from the other: so far
/// from both, m, and of a large enough area. Backs of faces have no such test: most lie within bodies and get no light.
///
/// - `largest_first`: what the cell cuts off, of which few are large enough where there are many
fn has_body_between(largest_first: &[&Piece], piece: &Piece, group: &Group, least_m: f32) -> bool {
    let n = group.normal.normalize_or_zero();
    let off_m = |centre: Vec3, area_m2: f32| n.dot(centre) / area_m2;
    let [a, b] = [off_m(piece.centre, piece.area_m2), off_m(group.centre, group.area_m2)];
    let between_m = a.min(b) + least_m..a.max(b) - least_m;
    let area_min_m2 = BETWEEN_SHARE * piece.area_m2.max(group.area_m2);
    largest_first.iter().take_while(|face| face.area_m2 >= area_min_m2).any(|face| {
        n.dot(face.normal) <= -JOINS_COS * face.area_m2
            && between_m.contains(&off_m(face.centre, face.area_m2))
    })
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

/// Side of a cell along the axis that `n` faces most.
pub(super) fn across_m(size_m: Vec3, n: Vec3) -> f32 {
    size_m[usize::from(axis_of(n) / 2)]
}
