//! The tree over one mesh's triangles, in mesh space relative to the mesh's centre.
//!
//! A mesh never changes once it is in a scene, so neither does its tree: instances and edits share it.

use fearless_simd::Simd;
use obvhs::aabb::Aabb;
use rayon::prelude::*;

use super::{
    leaf::{LEAF_MAX, Leaves, Shear, TriangleHit},
    node::Slab,
    stack::Entry,
    tree::{LeafKind, PARALLEL_MIN, Tree},
};
use crate::scene::Mesh;

/// A test of eight triangles takes about half as long again as one of eight boxes.
const LEAF_COST: f32 = 1.5;

/// See the module's head.
#[derive(Debug)]
pub(super) struct BottomTree {
    tree: Tree,
    leaves: Leaves,
}

impl BottomTree {
    pub(super) fn build(mesh: &Mesh) -> BottomTree {
        let bounds_of = |triangle: &[u32; 3]| {
            let [a, b, c] = triangle.map(|vertex| mesh.positions()[vertex as usize].into());
            Aabb::from_points(&[a, b, c])
        };
        let triangles = mesh.triangles().par_iter().with_min_len(PARALLEL_MIN);
        let bounds: Vec<Aabb> = triangles.map(bounds_of).collect();
        let kind = LeafKind { members_max: LEAF_MAX as u32, cost: LEAF_COST };
        let (tree, order) = Tree::build(&bounds, kind);
        let leaves = Leaves::pack(mesh, &order);
        BottomTree { tree, leaves }
    }

    pub(super) fn tree(&self) -> &Tree {
        &self.tree
    }

    pub(super) fn leaves(&self) -> &Leaves {
        &self.leaves
    }

    /// The numbers of a leaf's triangles.
    pub(super) fn triangles_of(&self, leaf: u32) -> impl Iterator<Item = u32> + '_ {
        self.leaves.packet(leaf).triangles()
    }

    pub(super) fn bytes(&self) -> usize {
        self.tree.bytes() + self.leaves.bytes()
    }

    /// Calls `found` with every triangle below `start` that is hit up to `t_max`; it may lower it, and ends the walk by
    /// true.
    #[inline(always)]
    pub(super) fn visit<S: Simd, const NEAREST_FIRST: bool>(
        &self,
        simd: S,
        start: u32,
        (slab, shear): (&Slab, &Shear),
        t_max: &mut f32,
        stack: &mut [Entry],
        mut found: impl FnMut(TriangleHit, &mut f32) -> bool,
    ) -> bool {
        self.tree.walk::<S, NEAREST_FIRST>(
            simd,
            start,
            slab,
            t_max,
            stack,
            #[inline(always)]
            |leaf, t_max, _| self.leaves.packet(leaf).intersect(simd, shear, t_max, &mut found),
        )
    }
}
