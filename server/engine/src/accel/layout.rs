//! Where the nodes and leaves of a tree lie in memory: what is visited together lies together.

use obvhs::bvh2::Bvh2;
use rayon::prelude::*;

use super::{
    collapse::{Chosen, Collapse},
    leaf::LEAF_MAX,
    node::{LEAF, WideNode},
    tree::PARALLEL_MIN,
};

/// Subtrees that threads share out among themselves. Fixed, as nothing may depend on the threads; nodes near the root have
/// mostly eight children, so that there are up to eight times as many.
const SUBTREES: usize = 64;

/// Bits of a leaf's name that say how many members it has.
const COUNT_BITS: u32 = 3;
const _: () = assert!(LEAF_MAX == 1 << COUNT_BITS, "a leaf's name must have room for any count of members");

/// Members of a tree in the order of its leaves.
#[derive(Debug, Default)]
pub(super) struct LeafOrder {
    /// Members leaf by leaf.
    pub(super) members: Vec<u32>,
    /// How many members each leaf has, 1 … 8.
    pub(super) counts: Vec<u8>,
}

impl LeafOrder {
    /// The first member of a leaf in the order and how many it has, from its name.
    #[inline(always)]
    pub(super) fn range_of(leaf: u32) -> (usize, usize) {
        ((leaf >> COUNT_BITS) as usize, (leaf & ((1 << COUNT_BITS) - 1)) as usize + 1)
    }

    /// Adds the leaf whose members `from` on have been added, and returns its name.
    pub(super) fn finish_leaf(&mut self, from: usize) -> u32 {
        let count = self.members.len() - from;
        debug_assert!((1..=LEAF_MAX).contains(&count));
        self.counts.push(count as u8);
        (from as u32) << COUNT_BITS | (count as u32 - 1)
    }
}

/// Nodes and leaves of a tree or a part of it, children behind their parents.
#[derive(Debug, Default)]
pub(super) struct Layout {
    pub(super) nodes: Vec<WideNode>,
    pub(super) order: LeafOrder,
}

/// A binary node that has become a node of eight, and the slot that is to lead to it.
#[derive(Clone, Copy)]
struct Pending {
    binary: usize,
    slot: Option<(usize, usize)>,
}

/// What every thread lays out with.
struct Work<'a> {
    binary: &'a Bvh2,
    choice: &'a Collapse<'a>,
}

impl Layout {
    /// Depth first, the largest child right behind its parent. In a large tree the nodes near the root come first, level by
    /// level, then the subtrees below them.
    pub(super) fn of(binary: &Bvh2, choice: &Collapse<'_>) -> Layout {
        let work = Work { binary, choice };
        let root = Pending { binary: 0, slot: None };
        if binary.primitive_indices.len() < PARALLEL_MIN {
            return work.lay_below(root);
        }
        let mut layout = Layout::default();
        let mut children = Vec::new();
        let mut level = vec![root];
        while !level.is_empty() && level.len() < SUBTREES {
            let mut below = Vec::new();
            for pending in level {
                work.lay(pending, &mut layout, &mut children, &mut below);
            }
            level = below;
        }
        let below: Vec<Layout> =
            level.par_iter().map(|pending| work.lay_below(Pending { slot: None, ..*pending })).collect();
        let sum = |count: fn(&Layout) -> usize| below.iter().map(count).sum();
        layout.nodes.reserve_exact(sum(|part| part.nodes.len()));
        layout.order.members.reserve_exact(sum(|part| part.order.members.len()));
        layout.order.counts.reserve_exact(sum(|part| part.order.counts.len()));
        for (pending, part) in level.into_iter().zip(below) {
            work.link(pending, &mut layout);
            layout.append(part);
        }
        layout
    }

    /// Puts nodes and leaves behind its own.
    fn append(&mut self, part: Layout) {
        let (nodes, members) = (self.nodes.len() as u32, self.order.members.len() as u32);
        self.nodes.extend(part.nodes.into_iter().map(|mut node| {
            node.lead_to(|child| child + if child & LEAF == 0 { nodes } else { members << COUNT_BITS });
            node
        }));
        self.order.members.extend(part.order.members);
        self.order.counts.extend(part.order.counts);
    }
}

impl Work<'_> {
    fn lay_below(&self, root: Pending) -> Layout {
        let mut layout = Layout::default();
        let mut children = Vec::new();
        let mut pending = vec![root];
        while let Some(next) = pending.pop() {
            self.lay(next, &mut layout, &mut children, &mut pending);
        }
        layout
    }

    /// Adds a node and its leaves; its other children are added to `pending`, the largest last.
    fn lay(
        &self,
        node: Pending,
        layout: &mut Layout,
        children: &mut Vec<Chosen>,
        pending: &mut Vec<Pending>,
    ) {
        let index = layout.nodes.len();
        self.link(node, layout);
        layout.nodes.push(WideNode::EMPTY);
        self.choice.children(node.binary, children);
        children.sort_by(|a, b| a.half_area.total_cmp(&b.half_area));
        for (slot, child) in children.iter().enumerate() {
            if child.is_leaf {
                let first = layout.order.members.len();
                self.choice.members(child.binary, &mut layout.order.members);
                let leaf = layout.order.finish_leaf(first);
                layout.nodes[index].set(slot, self.binary.nodes[child.binary].aabb(), LEAF | leaf);
            } else {
                pending.push(Pending { binary: child.binary, slot: Some((index, slot)) });
            }
        }
    }

    /// Leads the slot of a node to the next one.
    fn link(&self, node: Pending, layout: &mut Layout) {
        let index = layout.nodes.len() as u32;
        if let Some((parent, slot)) = node.slot {
            layout.nodes[parent].set(slot, self.binary.nodes[node.binary].aabb(), index);
        }
    }
}
