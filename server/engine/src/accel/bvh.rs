//! The tree: built by obvhs as a binary tree, collapsed to four children a node, walked front to back.

use std::time::Duration;

use glam::{Vec3, Vec4};
use obvhs::{
    Boundable, BvhBuildParams,
    aabb::Aabb,
    bvh2::{Bvh2, builder::build_bvh2},
};

/// Four children: their bounds side by side, and where each leads.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
struct Node {
    min: [Vec4; 3],
    max: [Vec4; 3],
    /// Inner: index of the node. Leaf: index of its first item. Unused: any.
    child: [u32; 4],
    /// 0 for an inner child, the number of items of a leaf, `UNUSED` where there is no child.
    count: [u32; 4],
}

const UNUSED: u32 = u32::MAX;

/// A node or leaf on the way, with the distance at which the ray enters it.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Entry {
    t_near: f32,
    child: u32,
    count: u32,
}

/// Room for `need` entries, for trees deeper than the usual stack.
pub(super) fn stack_of(need: usize) -> Vec<Entry> {
    vec![Entry::default(); need]
}

/// A tree over items 0…n−1 in its own order.
#[derive(Debug)]
pub(super) struct Bvh {
    nodes: Vec<Node>,
    depth: usize,
}

struct Bounds(Aabb);

impl Boundable for Bounds {
    fn aabb(&self) -> Aabb {
        self.0
    }
}

impl Bvh {
    /// Builds a tree over `bounds` with at most `leaf_max` items a leaf. Also returns the order of items:
    /// leaf ranges are runs of it.
    pub(super) fn build(bounds: &[Aabb], leaf_max: u32) -> (Bvh, Vec<u32>) {
        if bounds.is_empty() {
            return (Bvh { nodes: Vec::new(), depth: 0 }, Vec::new());
        }
        // obvhs's medium preset costs about Embree's build time; leaves no larger than one triangle packet.
        let params = BvhBuildParams { max_prims_per_leaf: leaf_max, ..BvhBuildParams::medium_build() };
        let items: Vec<Bounds> = bounds.iter().map(|bounds| Bounds(*bounds)).collect();
        let binary = build_bvh2(&items, params, &mut Duration::default());
        let mut bvh = Bvh { nodes: Vec::with_capacity(binary.nodes.len() / 2), depth: 0 };
        bvh.collapse(&binary);
        (bvh, binary.primitive_indices)
    }

    /// Turns the binary tree into nodes of four: the child with the largest area is opened until four are there.
    fn collapse(&mut self, binary: &Bvh2) {
        self.nodes.push(Node::EMPTY);
        let mut pending = vec![(0usize, 0usize, 1usize)];
        while let Some((node_index, binary_index, depth)) = pending.pop() {
            self.depth = self.depth.max(depth);
            let mut children = vec![binary_index];
            while children.len() < 4 {
                let open =
                    children.iter().enumerate().filter(|(_, child)| !binary.nodes[**child].is_leaf()).max_by(
                        |(_, a), (_, b)| {
                            let area = |child: &usize| binary.nodes[*child].aabb().half_area();
                            area(a).total_cmp(&area(b))
                        },
                    );
                let Some((position, child)) = open else { break };
                let first = binary.nodes[*child].first_index as usize;
                children[position] = first;
                children.push(first + 1);
            }
            for (slot, child) in children.into_iter().enumerate() {
                let source = &binary.nodes[child];
                let (leads_to, count) = if source.is_leaf() {
                    (source.first_index, source.prim_count)
                } else {
                    self.nodes.push(Node::EMPTY);
                    pending.push((self.nodes.len() - 1, child, depth + 1));
                    (self.nodes.len() as u32 - 1, 0)
                };
                self.nodes[node_index].set(slot, source.aabb(), leads_to, count);
            }
        }
    }

    /// Gives every leaf one item of its own: `make(first, count)` names it.
    pub(super) fn replace_leaves(&mut self, mut make: impl FnMut(u32, u32) -> u32) {
        for node in &mut self.nodes {
            for slot in 0..4 {
                if node.count[slot] != 0 && node.count[slot] != UNUSED {
                    node.child[slot] = make(node.child[slot], node.count[slot]);
                    node.count[slot] = 1;
                }
            }
        }
    }

    /// Entries that a walk may have waiting at once: three siblings a level, and the node itself.
    pub(super) fn stack_need(&self) -> usize {
        self.depth * 3 + 1
    }

    pub(super) fn bytes(&self) -> usize {
        self.nodes.len() * size_of::<Node>()
    }

    /// Walks the leaves that `ray` enters before `t_max`, nearest first, and calls `visit` with each item and the
    /// unused part of the stack. `visit` may lower `t_max` and ends the walk by returning true.
    #[inline]
    pub(super) fn traverse(
        &self,
        ray: &SlabRay,
        t_max: &mut f32,
        stack: &mut [Entry],
        mut visit: impl FnMut(u32, &mut f32, &mut [Entry]) -> bool,
    ) -> bool {
        if self.nodes.is_empty() {
            return false;
        }
        let mut current = Entry { t_near: 0.0, child: 0, count: 0 };
        let mut height = 0;
        loop {
            if current.count == 0 {
                let node = &self.nodes[current.child as usize];
                let (mut entered, t_near) = node.enter(ray, *t_max);
                let bottom = height;
                while entered != 0 {
                    let slot = entered.trailing_zeros() as usize;
                    entered &= entered - 1;
                    let entry =
                        Entry { t_near: t_near[slot], child: node.child[slot], count: node.count[slot] };
                    // Insertion keeps the nearest child on top of the stack.
                    let mut at = height;
                    while at > bottom && stack[at - 1].t_near < entry.t_near {
                        stack[at] = stack[at - 1];
                        at -= 1;
                    }
                    stack[at] = entry;
                    height += 1;
                }
            } else {
                for item in current.child..current.child + current.count {
                    if visit(item, t_max, &mut stack[height..]) {
                        return true;
                    }
                }
            }
            loop {
                if height == 0 {
                    return false;
                }
                height -= 1;
                if stack[height].t_near <= *t_max {
                    break;
                }
            }
            current = stack[height];
        }
    }
}

/// A ray made ready for box tests.
#[derive(Clone, Copy, Debug)]
pub(super) struct SlabRay {
    origin: [Vec4; 3],
    inverse: [Vec4; 3],
}

impl SlabRay {
    pub(super) fn new(origin: Vec3, direction: Vec3) -> SlabRay {
        // Below 1e-30 the reciprocal would be infinite and 0 · ∞ a NaN; a ray that slow along an axis
        // crosses no slab of it within any distance f32 holds.
        let reciprocal = |d: f32| if d.abs() > 1e-30 { 1.0 / d } else { 1e30f32.copysign(d) };
        SlabRay {
            origin: [Vec4::splat(origin.x), Vec4::splat(origin.y), Vec4::splat(origin.z)],
            inverse: [
                Vec4::splat(reciprocal(direction.x)),
                Vec4::splat(reciprocal(direction.y)),
                Vec4::splat(reciprocal(direction.z)),
            ],
        }
    }
}

impl Node {
    const EMPTY: Node =
        Node { min: [Vec4::INFINITY; 3], max: [Vec4::NEG_INFINITY; 3], child: [0; 4], count: [UNUSED; 4] };

    fn set(&mut self, slot: usize, bounds: &Aabb, child: u32, count: u32) {
        for axis in 0..3 {
            self.min[axis][slot] = bounds.min[axis];
            self.max[axis][slot] = bounds.max[axis];
        }
        self.child[slot] = child;
        self.count[slot] = count;
    }

    /// Bit mask of the children that the ray enters before `t_max`, and where it enters each.
    #[inline]
    fn enter(&self, ray: &SlabRay, t_max: f32) -> (u32, Vec4) {
        let mut near = Vec4::ZERO;
        let mut far = Vec4::INFINITY;
        for axis in 0..3 {
            let t0 = (self.min[axis] - ray.origin[axis]) * ray.inverse[axis];
            let t1 = (self.max[axis] - ray.origin[axis]) * ray.inverse[axis];
            near = near.max(t0.min(t1));
            far = far.min(t0.max(t1));
        }
        // Rounding must never lose a box: 1 + 2γ₃ widens the far side enough [Ize2013]. An unused slot has
        // min > max; its t0, t1 are ±∞ in both orders, so it is told by its count instead.
        let entered = near.cmple((far * (1.0 + 8e-7)).min(Vec4::splat(t_max))).bitmask();
        let used = (0..4).fold(0, |mask, slot| mask | u32::from(self.count[slot] != UNUSED) << slot);
        (entered & used, near)
    }
}
