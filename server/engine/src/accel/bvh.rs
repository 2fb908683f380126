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
    /// Index of a node, or `LEAF` and the index of an item.
    child: [u32; 4],
    /// Bit k: there is a child k.
    used: u32,
}

/// Marks a child that is an item rather than a node.
const LEAF: u32 = 1 << 31;

/// A node or leaf on the way, with the distance at which the ray enters it.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Entry {
    t_near: f32,
    child: u32,
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
    /// Builds a tree over `bounds` whose leaves hold at most `leaf_max` of them each: `make_item(members)` turns the
    /// members of a leaf, by index into `bounds`, into the one item that the leaf stands for.
    pub(super) fn build(bounds: &[Aabb], leaf_max: u32, mut make_item: impl FnMut(&[u32]) -> u32) -> Bvh {
        let mut bvh = Bvh { nodes: Vec::new(), depth: 0 };
        if bounds.is_empty() {
            return bvh;
        }
        // obvhs's medium preset costs about Embree's build time; leaves no larger than one triangle packet.
        let params = BvhBuildParams { max_prims_per_leaf: leaf_max, ..BvhBuildParams::medium_build() };
        let items: Vec<Bounds> = bounds.iter().map(|bounds| Bounds(*bounds)).collect();
        let binary = build_bvh2(&items, params, &mut Duration::default());
        bvh.nodes.reserve(binary.nodes.len() / 2);
        bvh.collapse(&binary, &mut make_item);
        bvh
    }

    /// Turns the binary tree into nodes of four: the child with the largest area is opened until four are there.
    fn collapse(&mut self, binary: &Bvh2, make_item: &mut impl FnMut(&[u32]) -> u32) {
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
                let leads_to = if source.is_leaf() {
                    let first = source.first_index as usize;
                    LEAF | make_item(&binary.primitive_indices[first..first + source.prim_count as usize])
                } else {
                    self.nodes.push(Node::EMPTY);
                    pending.push((self.nodes.len() - 1, child, depth + 1));
                    self.nodes.len() as u32 - 1
                };
                self.nodes[node_index].set(slot, source.aabb(), leads_to);
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
        let mut current = Entry::default();
        let mut height = 0;
        loop {
            if current.child & LEAF == 0 {
                let node = &self.nodes[current.child as usize];
                let (mut entered, t_near) = node.enter(ray, *t_max);
                let bottom = height;
                while entered != 0 {
                    let slot = entered.trailing_zeros() as usize;
                    entered &= entered - 1;
                    let entry = Entry { t_near: t_near[slot], child: node.child[slot] };
                    // Insertion keeps the nearest child on top of the stack.
                    let mut at = height;
                    while at > bottom && stack[at - 1].t_near < entry.t_near {
                        stack[at] = stack[at - 1];
                        at -= 1;
                    }
                    stack[at] = entry;
                    height += 1;
                }
            } else if visit(current.child & !LEAF, t_max, &mut stack[height..]) {
                return true;
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
            origin: origin.to_array().map(Vec4::splat),
            inverse: [
                Vec4::splat(reciprocal(direction.x)),
                Vec4::splat(reciprocal(direction.y)),
                Vec4::splat(reciprocal(direction.z)),
            ],
        }
    }

    /// The same direction from another origin.
    pub(super) fn from(&self, origin: Vec3) -> SlabRay {
        SlabRay { origin: origin.to_array().map(Vec4::splat), ..*self }
    }
}

impl Node {
    const EMPTY: Node = Node { min: [Vec4::ZERO; 3], max: [Vec4::ZERO; 3], child: [0; 4], used: 0 };

    fn set(&mut self, slot: usize, bounds: &Aabb, child: u32) {
        for axis in 0..3 {
            self.min[axis][slot] = bounds.min[axis];
            self.max[axis][slot] = bounds.max[axis];
        }
        self.child[slot] = child;
        self.used |= 1 << slot;
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
        // Rounding must never lose a box: 1 + 2γ₃ widens the far side enough [Ize2013].
        let entered = near.cmple((far * (1.0 + 8e-7)).min(Vec4::splat(t_max))).bitmask();
        (entered & self.used, near)
    }
}
