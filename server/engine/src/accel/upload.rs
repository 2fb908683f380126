//! The trees packed for the GPU: plain data in the order in which a shader reads it.
//!
//! Imports `scene`; knows no graphics interface. Compressed wide nodes are those of [Ylitie2017], with another encoding
//! of leaves; the two levels, the boxes' room for rounding and the triangle test are the CPU's, so that both meet the
//! same triangles. `accel/tree.wgsl` of the crate `lumicast-shaders` walks these buffers; `upload/twin.rs` (tests only) is the
//! same walk, statement by statement.
//!
//! **Node**, 80 bytes, in WGSL `array<vec4u, 5>`. Byte k of a word is `word >> 8k & 0xff`.
//!
//! | vec4 | words | |
//! | --- | --- | --- |
//! | 0 | x y z | `origin`, f32: the corner from which planes are counted |
//! | 0 | w | bytes 0–2 `exponents` of x, y, z; byte 3 `inner`, bit s: slot s leads to a node |
//! | 1 | x | `child_base`: nodes below lie side by side from here, in the order of their slots |
//! | 1 | y | `member_base`: members (triangles; parts, in the top tree) lie side by side from here |
//! | 1 | z w | `member_ends` of slots 0–3 and 4–7: members in this slot and all before it |
//! | 2 3 4 | xy zw | planes of the axis: low of slots 0–3 and 4–7, high of slots 0–3 and 4–7 |
//!
//! - plane = `origin + q · bitcast<f32>(exponent << 23)`. The product of a byte and a power of two is exact, the sum rounds
//!   once, and packing made sure of the rounded sum: boxes decoded so hold the exact ones. The walk meets planes without that
//!   sum, half a unit of it aside, for which its boxes have room.
//! - node below slot s = `child_base + countOneBits(inner & ((1 << s) - 1))`
//! - members of slot s = `member_base + (member_ends[s - 1] .. member_ends[s])`, from 0 for slot 0; none for an inner or
//!   a free slot. A slot is free when it is not inner and has no members; its planes are zero and mean nothing.
//!
//! Why not the paper's byte per slot: it counts up to three triangles in unary and 24 in a node, our leaves hold up to
//! eight, a node up to 64, and a count with an offset takes nine bits. The sums take seven, offset and count are one
//! subtraction, and the node stays at 80 bytes.
//!
//! Bit 0, 1, 2 of a slot's number say that its child tends to the high side of x, y, z, as far as eight children can
//! have it so. A ray that visits slots in the order of `slot ^ octant`, bit a of `octant` set where its direction is
//! negative on axis a, meets near ones first without sorting; its stack holds one (`child_base`, `inner`, slots left) a
//! level, and the parts left of one node of the top tree: [`AccelBuffers::stack_need`] entries for both levels together.
//!
//! **Triangle**, 48 bytes, `array<vec4f, 3>`: a corner in each xyz, relative to the mesh's centre; w holds the number in
//! the mesh with the plane's axis in its two highest bits, and the plane's two slopes. Whether it is hit is decided by
//! the signs of the edge functions as on the CPU. WGSL may fuse and reorder, so signs too close to call are computed
//! again in integers, see the twin: what a compiler does to the rest cannot open a seam. *Where* it is hit: WGSL has no
//! f64, but the slopes were computed in it. With axis k, the next axes i, j and p = first corner − ray origin,
//! t = (p[k] + slope₀ p[i] + slope₁ p[j]) / (d[k] + slope₀ d[i] + slope₁ d[j]), off by a few roundings whatever the
//! triangle's shape, then held between the distances of the nearest and the farthest corner. Axis 3: the corners lie on
//! a line and hide nothing. Tried and dropped: the normal from f32 edges at the corner between the two shortest, which
//! on slivers of 10 m × 2 mm was off by 150 times as much, the more the nearer that corner's angle is to 180°.
//!
//! **Part**, 8 bytes, `vec2u`: instance; where it starts in the mesh's tree, relative to the instance's bases. Bit 31
//! clear: a node. Set: a leaf, bits 28–30 its triangles − 1, bits 0–27 the first; a mesh has no more than 2²⁸ triangles,
//! or the CPU's leaves could not name them.
//!
//! **Instance**, 64 bytes, `array<vec4f, 4>`: see [`GpuInstance`].
//!
//! No number is infinite or NaN. All words are little-endian.

mod pack;
#[cfg(test)]
pub(crate) mod tests;
#[cfg(test)]
pub(crate) mod twin;

use bytemuck::{Pod, Zeroable};
use rayon::prelude::*;

use super::{Accel, instance::Instance};
use crate::scene::{Id, Mesh};
use pack::{PackedTree, pack, plane_of};

/// [`GpuInstance::flags`]: moved, but neither turned nor scaled; the ray's direction stays as it is.
pub const INSTANCE_IS_ONLY_MOVED: u32 = 1;
/// [`GpuInstance::flags`]: the transform mirrors.
pub const INSTANCE_IS_MIRRORED: u32 = 2;
/// [`GpuPart::start`]: the part is a leaf.
pub const START_IS_LEAF: u32 = 1 << 31;
/// [`GpuPart::start`]: where the count of a leaf's triangles, less one, begins.
pub const START_COUNT_SHIFT: u32 = 28;
/// [`GpuTriangle::number`]: where the plane's axis begins.
pub const TRIANGLE_AXIS_SHIFT: u32 = 30;

/// A node of up to eight children; the module's head says how it is read.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct GpuNode {
    /// Low corner of the node's bounds.
    pub origin: [f32; 3],
    /// Exponents of the planes' step on x, y, z, as an f32 stores them: 1 to 254.
    pub exponents: [u8; 3],
    /// Bit s: slot s leads to a node.
    pub inner: u8,
    /// The first node below.
    pub child_base: u32,
    /// The first member.
    pub member_base: u32,
    /// Members in a slot and all before it.
    pub member_ends: [u8; 8],
    /// `[axis][side][slot]`, side 0 low, 1 high: planes in steps from `origin`.
    pub planes: [[[u8; 8]; 2]; 3],
}

/// A triangle; the module's head says how it is met.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct GpuTriangle {
    /// First corner, relative to the mesh's centre.
    pub a: [f32; 3],
    /// Bits 0–29 the number in the mesh; 30–31 the axis on which the normal is longest, 3 where there is no plane.
    pub number: u32,
    /// Second corner.
    pub b: [f32; 3],
    /// The normal along the axis after, in lengths of the longest: −1 to 1.
    pub slope_0: f32,
    /// Third corner.
    pub c: [f32; 3],
    /// The normal along the axis after that.
    pub slope_1: f32,
}

/// A subtree of an instance's mesh: what leaves of the top tree name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct GpuPart {
    /// Index of the instance, as in [`Accel::instances`].
    pub instance: u32,
    /// The node or leaf of the mesh's tree; the module's head says how it is read.
    pub start: u32,
}

/// What takes a ray into an instance's mesh: `mesh_from_render * (origin - centre_in_render)`.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct GpuInstance {
    /// First column of mesh from render.
    pub mesh_from_render_x: [f32; 3],
    /// Where the mesh's nodes start in [`AccelBuffers::nodes`].
    pub node_base: u32,
    /// Second column.
    pub mesh_from_render_y: [f32; 3],
    /// Where the mesh's triangles start in [`AccelBuffers::triangles`].
    pub triangle_base: u32,
    /// Third column.
    pub mesh_from_render_z: [f32; 3],
    /// `INSTANCE_IS_…`
    pub flags: u32,
    /// The mesh's centre in render space.
    pub centre_in_render: [f32; 3],
    /// Largest coordinate of the mesh from its centre: room for rounding is in proportion to it.
    pub mesh_reach: f32,
}

/// Where a mesh lies in the buffers.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MeshRange {
    /// The mesh.
    pub mesh_id: Id,
    /// Its first node in [`AccelBuffers::nodes`], to which its nodes' `child_base` is relative.
    pub node_base: u32,
    /// Its first triangle in [`AccelBuffers::triangles`], to which its nodes' `member_base` is relative.
    pub triangle_base: u32,
    /// Its triangles.
    pub triangle_count: u32,
}

/// A scene's trees, ready to be copied into storage buffers.
///
/// `nodes` and `triangles` change with the meshes only, the others with every edit of what stands where.
/// In a scene that shows nothing all are empty but `top_nodes`, whose root is there always.
#[derive(Clone, Debug, PartialEq)]
pub struct AccelBuffers {
    /// The tree over parts. Its members are `parts`, one a leaf; its bases are absolute.
    pub top_nodes: Vec<GpuNode>,
    /// In the order of the top tree's leaves.
    pub parts: Vec<GpuPart>,
    /// By the index that a hit carries.
    pub instances: Vec<GpuInstance>,
    /// The trees of all meshes, each once; bases are relative to the mesh's.
    pub nodes: Vec<GpuNode>,
    /// The triangles of all meshes, in the order of their leaves.
    pub triangles: Vec<GpuTriangle>,
    /// Where each mesh lies, ordered by id.
    pub meshes: Vec<MeshRange>,
    /// Largest coordinate of the top tree's bounds, in render space.
    pub top_reach: f32,
    /// Entries that a walk may have waiting at once, both levels together.
    pub stack_need: usize,
}

impl AccelBuffers {
    /// Bytes to upload.
    pub fn bytes(&self) -> usize {
        size_of_val(&*self.top_nodes)
            + size_of_val(&*self.parts)
            + size_of_val(&*self.instances)
            + size_of_val(&*self.nodes)
            + size_of_val(&*self.triangles)
    }

    /// Bytes to upload for each triangle of the meshes; those of the root in a scene that shows nothing.
    pub fn bytes_per_triangle(&self) -> f64 {
        self.bytes() as f64 / self.triangles.len().max(1) as f64
    }
}

struct PackedMesh {
    tree: PackedTree,
    triangles: Vec<GpuTriangle>,
}

impl Accel {
    /// The trees as they are now, packed for the GPU. The same trees give the same bytes.
    pub fn upload(&self) -> AccelBuffers {
        let mut shown: Vec<_> = self.bottoms.iter().collect();
        shown.sort_unstable_by_key(|(id, _)| *id);
        let packed: Vec<PackedMesh> = shown
            .par_iter()
            .map(|(_, (mesh, bottom))| {
                let mut triangles = Vec::with_capacity(mesh.triangles().len());
                let tree = pack(bottom.tree(), |leaf| {
                    let before = triangles.len();
                    triangles.extend(bottom.triangles_of(leaf).map(|number| triangle_of(mesh, number)));
                    (triangles.len() - before) as u8
                });
                PackedMesh { tree, triangles }
            })
            .collect();
        let mut meshes = Vec::with_capacity(shown.len());
        let (mut nodes, mut triangles) = (Vec::new(), Vec::new());
        for ((id, _), packed) in shown.iter().zip(&packed) {
            meshes.push(MeshRange {
                mesh_id: (*id).clone(),
                node_base: nodes.len() as u32,
                triangle_base: triangles.len() as u32,
                triangle_count: packed.triangles.len() as u32,
            });
            nodes.extend_from_slice(&packed.tree.nodes);
            triangles.extend_from_slice(&packed.triangles);
        }
        // Every instance's mesh is among those shown.
        let mesh_of = |instance: &Instance| {
            meshes.binary_search_by(|mesh| mesh.mesh_id.cmp(instance.mesh_id())).unwrap_or_default()
        };
        let top = self.top.tree();
        let mut parts = Vec::new();
        let top_tree = pack(top.tree(), |leaf| {
            let part = top.part(leaf);
            let mesh = mesh_of(&self.instances[part.instance as usize]);
            parts.push(GpuPart {
                instance: part.instance,
                start: packed[mesh].tree.starts.get(&part.child).copied().unwrap_or_default(),
            });
            1
        });
        let bottom_need = packed.iter().map(|mesh| mesh.tree.stack_need).max().unwrap_or(0);
        AccelBuffers {
            parts,
            instances: self.instances.iter().map(|i| instance_of(i, &meshes[mesh_of(i)])).collect(),
            top_reach: reach_of(top.tree()),
            stack_need: top_tree.stack_need + 1 + bottom_need,
            top_nodes: top_tree.nodes,
            nodes,
            triangles,
            meshes,
        }
    }
}

/// Largest coordinate of a tree's bounds; zero for an empty one, whose bounds are turned inside out.
fn reach_of(tree: &super::tree::Tree) -> f32 {
    let bounds = tree.bounds();
    if bounds.min.x > bounds.max.x { 0.0 } else { bounds.min.abs().max(bounds.max.abs()).max_element() }
}

fn triangle_of(mesh: &Mesh, number: u32) -> GpuTriangle {
    let [a, b, c] = mesh.triangles()[number as usize].map(|vertex| mesh.positions()[vertex as usize]);
    let (axis, [slope_0, slope_1]) = plane_of([a, b, c]);
    GpuTriangle {
        a: a.into(),
        number: number | axis << TRIANGLE_AXIS_SHIFT,
        b: b.into(),
        slope_0,
        c: c.into(),
        slope_1,
    }
}

fn instance_of(instance: &Instance, mesh: &MeshRange) -> GpuInstance {
    let [x, y, z] = instance.mesh_from_render().to_cols_array_2d();
    let only_moved = if instance.is_only_moved() { INSTANCE_IS_ONLY_MOVED } else { 0 };
    let mirrored = if instance.handedness() < 0.0 { INSTANCE_IS_MIRRORED } else { 0 };
    GpuInstance {
        mesh_from_render_x: x,
        node_base: mesh.node_base,
        mesh_from_render_y: y,
        triangle_base: mesh.triangle_base,
        mesh_from_render_z: z,
        flags: only_moved | mirrored,
        centre_in_render: instance.centre_in_render().into(),
        mesh_reach: reach_of(instance.bottom().tree()),
    }
}
