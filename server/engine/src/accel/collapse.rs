//! From a binary tree to nodes of eight, at the least cost there is [Ylitie2017, 3.1].
//!
//! Which binary nodes become nodes, which become leaves and which vanish into their parent is chosen by dynamic
//! programming from the leaves up: for every binary node, what it costs to stand for its triangles with at most one, two …
//! seven children of some node above. Costs are needed by the parent alone and live on a stack; what is kept is the
//! choice, four bytes a node.

use std::sync::atomic::{AtomicU32, Ordering};

use obvhs::bvh2::Bvh2;
use rayon::prelude::*;

use super::{
    node::WIDTH,
    tree::{LeafKind, PARALLEL_MIN},
};

/// What visiting a node costs by the surface area heuristic: the unit.
const NODE_COST: f32 = 1.0;

/// How many ways there are to stand for a binary node: by at most 1 … 7 children.
const WAYS: usize = WIDTH - 1;

/// Subtrees that threads share out among themselves: enough that two or sixteen are done at about the same time although
/// subtrees differ in size, few enough that a subtree is worth a task. Fixed, as nothing may depend on the threads.
const SUBTREES: usize = 256;

/// The choice for every binary node.
pub(super) struct Collapse<'a> {
    binary: &'a Bvh2,
    /// Written by many threads, every place by one of them, and read after they have met again: no order is asked for.
    choices: Vec<AtomicU32>,
}

/// The cheapest way to stand for one binary node by so many children.
///
/// Of n children, 2 … 8, how many are the left side's in the cheapest split, in three bits each; 0 where fewer children
/// cost less.
#[derive(Clone, Copy)]
struct Choice(u32);

/// Set where the node as one child is a leaf.
const IS_LEAF: u32 = 1 << 31;

impl Choice {
    fn is_leaf(self) -> bool {
        self.0 & IS_LEAF != 0
    }

    fn of_left(self, children: usize) -> usize {
        (self.0 >> (3 * (children - 2)) & 7) as usize
    }
}

/// Least costs of one binary node with at most 1 … 7 children, and what is below it.
#[derive(Clone, Copy)]
struct Costs {
    of: [f32; WAYS],
    members: u32,
}

/// A node near the root.
struct Part {
    node: usize,
    /// The place of its left side, the right one's is next; `None` for the root of a subtree that is chosen for on its own.
    left: Option<usize>,
}

/// A child of a node of eight.
#[derive(Clone, Copy)]
pub(super) struct Chosen {
    /// The binary node it stands for.
    pub(super) binary: usize,
    pub(super) is_leaf: bool,
    pub(super) half_area: f32,
}

impl<'a> Collapse<'a> {
    /// Chooses for a tree with members one by one in its leaves.
    pub(super) fn choose(binary: &'a Bvh2, leaves: LeafKind) -> Collapse<'a> {
        let mut choices = Vec::new();
        choices.resize_with(binary.nodes.len(), AtomicU32::default);
        let collapse = Collapse { binary, choices };
        if binary.primitive_indices.len() < PARALLEL_MIN {
            if !binary.nodes.is_empty() {
                collapse.choose_below(0, leaves);
            }
            return collapse;
        }
        let parts = collapse.parts();
        let below = |part: &Part| match part.left {
            None => collapse.choose_below(part.node, leaves),
            Some(_) => None,
        };
        let mut costs: Vec<Option<Costs>> = parts.par_iter().map(below).collect();
        // Sides come after their parents: the other way round they are known before they are asked for.
        for (index, part) in parts.iter().enumerate().rev() {
            if let Some(left) = part.left
                && let (Some(l), Some(r)) = (costs[left], costs[left + 1])
            {
                costs[index] = Some(collapse.choose_one(part.node, &l, &r, leaves));
            }
        }
        collapse
    }

    /// The nodes near the root, level by level, down to the subtrees.
    fn parts(&self) -> Vec<Part> {
        let mut parts = vec![Part { node: 0, left: None }];
        let mut next = 0;
        while next < parts.len() && parts.len() < 2 * SUBTREES {
            if let Some(sides) = self.sides(parts[next].node) {
                parts[next].left = Some(parts.len());
                parts.extend(sides.map(|node| Part { node, left: None }));
            }
            next += 1;
        }
        parts
    }

    /// Chooses for a node and all below it.
    fn choose_below(&self, root: usize, leaves: LeafKind) -> Option<Costs> {
        // Parents before children, right before left: the other way round, a node finds its sides' costs on top of the
        // stack. Trees may be too deep for calls.
        let mut order = Vec::new();
        let mut pending = vec![root as u32];
        while let Some(at) = pending.pop() {
            order.push(at);
            if let Some(sides) = self.sides(at as usize) {
                pending.extend(sides.map(|side| side as u32));
            }
        }
        let mut stack: Vec<Costs> = Vec::new();
        for at in order.into_iter().rev().map(|at| at as usize) {
            let node = &self.binary.nodes[at];
            if node.is_leaf() {
                self.choices[at].store(IS_LEAF, Ordering::Relaxed);
                let cost = node.aabb().half_area() * leaves.cost;
                stack.push(Costs { of: [cost; WAYS], members: node.prim_count });
            } else if let (Some(r), Some(l)) = (stack.pop(), stack.pop()) {
                stack.push(self.choose_one(at, &l, &r, leaves));
            }
        }
        stack.pop()
    }

    fn sides(&self, at: usize) -> Option<[usize; 2]> {
        let node = &self.binary.nodes[at];
        (!node.is_leaf()).then(|| [node.first_index as usize, node.first_index as usize + 1])
    }

    /// Chooses for a node whose sides cost `l` and `r`.
    #[inline]
    fn choose_one(&self, at: usize, l: &Costs, r: &Costs, leaves: LeafKind) -> Costs {
        let area = self.binary.nodes[at].aabb().half_area();
        let (split, of_left) = match (l.members, r.members) {
            // One member costs the same by however many children: the other side has all but one.
            (_, 1) => (with_one(&l.of, r.of[0]), ALL_BUT_ONE),
            (1, _) => (with_one(&r.of, l.of[0]), [1; WIDTH]),
            _ => cheapest_splits(&l.of, &r.of),
        };
        let members = l.members + r.members;
        let as_leaf = if members <= leaves.members_max { area * leaves.cost } else { f32::INFINITY };
        let as_node = split[WAYS - 1] + area * NODE_COST;
        let mut choice = if as_leaf <= as_node { IS_LEAF } else { 0 };
        let mut costs = Costs { of: [as_leaf.min(as_node); WAYS], members };
        for ways in 1..WAYS {
            let (cost, fewer) = (split[ways - 1], costs.of[ways - 1]);
            costs.of[ways] = cost.min(fewer);
            choice |= if cost < fewer { of_left[ways - 1] << (3 * (ways - 1)) } else { 0 };
        }
        // A node has eight children to give, whatever that costs.
        choice |= of_left[WAYS - 1] << (3 * (WAYS - 1));
        self.choices[at].store(choice, Ordering::Relaxed);
        costs
    }

    fn choice(&self, at: usize) -> Choice {
        Choice(self.choices[at].load(Ordering::Relaxed))
    }

    /// The children of the node that stands for a binary node.
    pub(super) fn children(&self, at: usize, chosen: &mut Vec<Chosen>) {
        chosen.clear();
        if self.choice(at).is_leaf() {
            chosen.push(self.chosen(at));
            return;
        }
        self.distribute(at, WIDTH, chosen);
    }

    /// Adds the children that stand for both sides of `at`, at most `most` of them, two at least.
    fn distribute(&self, at: usize, most: usize, chosen: &mut Vec<Chosen>) {
        if let Some([left, right]) = self.sides(at) {
            let of_left = self.choice(at).of_left(most);
            self.stand_for(left, of_left, chosen);
            self.stand_for(right, most - of_left, chosen);
        }
    }

    /// Adds the children that stand for `at`, at most `most` of them.
    fn stand_for(&self, at: usize, mut most: usize, chosen: &mut Vec<Chosen>) {
        let choice = self.choice(at);
        while most > 1 && choice.of_left(most) == 0 {
            most -= 1;
        }
        if most > 1 {
            self.distribute(at, most, chosen);
        } else {
            chosen.push(self.chosen(at));
        }
    }

    fn chosen(&self, at: usize) -> Chosen {
        let half_area = self.binary.nodes[at].aabb().half_area();
        Chosen { binary: at, is_leaf: self.choice(at).is_leaf(), half_area }
    }

    /// Adds the members below a binary node that is a leaf, of which there are few.
    pub(super) fn members(&self, at: usize, members: &mut Vec<u32>) {
        match self.sides(at) {
            Some(sides) => sides.into_iter().for_each(|side| self.members(side, members)),
            None => {
                let node = &self.binary.nodes[at];
                let first = node.first_index as usize;
                members.extend(&self.binary.primitive_indices[first..first + node.prim_count as usize]);
            }
        }
    }
}

/// Of 2 … 8 children, all but one.
const ALL_BUT_ONE: [u32; WIDTH] = [1, 2, 3, 4, 5, 6, 7, 0];

/// Costs with one more child, which costs `one`.
#[inline(always)]
fn with_one(of: &[f32; WAYS], one: f32) -> [f32; WIDTH] {
    let mut with = [f32::INFINITY; WIDTH];
    with.iter_mut().zip(of).for_each(|(with, of)| *with = of + one);
    with
}

/// The least cost of standing for two sides by 2 … 8 children, and how many of those are the left side's.
///
/// For every number of the left side's, all seven sums at once: compilers make vector instructions of the inner loop, as
/// it has neither branches nor bounds of its own.
#[inline(always)]
fn cheapest_splits(l: &[f32; WAYS], r: &[f32; WAYS]) -> ([f32; WIDTH], [u32; WIDTH]) {
    // r[n] stands at WIDTH + n: before it, there is nothing left to give to the right side.
    let mut shifted = [f32::INFINITY; 2 * WIDTH];
    shifted[WIDTH..WIDTH + WAYS].copy_from_slice(r);
    let (mut least, mut of_left) = ([f32::INFINITY; WIDTH], [0u32; WIDTH]);
    for (left, l) in l.iter().enumerate() {
        let right: &[f32; WIDTH] = shifted[WIDTH - left..].first_chunk().unwrap_or(&[f32::INFINITY; WIDTH]);
        for lane in 0..WIDTH {
            let cost = l + right[lane];
            let is_less = cost < least[lane];
            least[lane] = if is_less { cost } else { least[lane] };
            of_left[lane] = if is_less { left as u32 + 1 } else { of_left[lane] };
        }
    }
    (least, of_left)
}
