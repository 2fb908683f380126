//! From a binary tree to nodes of eight, at the least cost there is [Ylitie2017, 3.1].
//!
//! Which binary nodes become nodes, which become leaves and which vanish into their parent is chosen by dynamic
//! programming from the leaves up: for every binary node, what it costs to stand for its triangles with at most one, two …
//! seven children of some node above.

use obvhs::bvh2::Bvh2;

use super::{node::WIDTH, tree::LeafKind};

/// What visiting a node costs by the surface area heuristic: the unit.
const NODE_COST: f32 = 1.0;

/// How many ways there are to stand for a binary node: by at most 1 … 7 children.
const WAYS: usize = WIDTH - 1;

/// The choice for every binary node.
pub(super) struct Collapse<'a> {
    binary: &'a Bvh2,
    plans: Vec<Plan>,
}

/// The cheapest ways to stand for one binary node.
#[derive(Clone, Copy)]
struct Plan {
    /// Least cost with at most 1 … 7 children.
    cost: [f32; WAYS],
    /// Of n + 2 children, how many are the left side's in the cheapest split; 0 where fewer children cost less.
    left: [u8; WAYS],
    /// As one child it is a leaf.
    is_leaf: bool,
    members: u32,
}

/// A child of a node of eight.
#[derive(Clone, Copy)]
pub(super) struct Chosen {
    /// The binary node it stands for.
    pub(super) binary: usize,
    pub(super) is_leaf: bool,
}

impl<'a> Collapse<'a> {
    /// Chooses for a tree with members one by one in its leaves.
    pub(super) fn choose(binary: &'a Bvh2, leaves: LeafKind) -> Collapse<'a> {
        let none = Plan { cost: [f32::INFINITY; WAYS], left: [0; WAYS], is_leaf: true, members: 0 };
        let mut collapse = Collapse { binary, plans: vec![none; binary.nodes.len()] };
        // Parents before children: the other way round every child is known before it is asked for.
        let mut order = Vec::with_capacity(binary.nodes.len());
        let mut pending: Vec<usize> = if binary.nodes.is_empty() { Vec::new() } else { vec![0] };
        while let Some(at) = pending.pop() {
            order.push(at);
            if let Some([left, right]) = collapse.sides(at) {
                pending.extend([left, right]);
            }
        }
        for at in order.into_iter().rev() {
            collapse.plans[at] = collapse.plan(at, leaves);
        }
        collapse
    }

    fn sides(&self, at: usize) -> Option<[usize; 2]> {
        let node = &self.binary.nodes[at];
        (!node.is_leaf()).then(|| [node.first_index as usize, node.first_index as usize + 1])
    }

    fn plan(&self, at: usize, leaves: LeafKind) -> Plan {
        let area = self.binary.nodes[at].aabb().half_area();
        let Some([left, right]) = self.sides(at) else {
            let members = self.binary.nodes[at].prim_count;
            return Plan { cost: [area * leaves.cost; WAYS], left: [0; WAYS], is_leaf: true, members };
        };
        let (l, r) = (&self.plans[left], &self.plans[right]);
        // Split[n]: as n + 2 children, of which the left side has how many.
        let mut split = [(f32::INFINITY, 0u8); WAYS];
        for (ways, best) in split.iter_mut().enumerate() {
            for of_left in 0..=ways {
                let cost = l.cost[of_left] + r.cost[ways - of_left];
                if cost < best.0 {
                    *best = (cost, of_left as u8 + 1);
                }
            }
        }
        let members = l.members + r.members;
        let as_leaf = if members <= leaves.members_max { area * leaves.cost } else { f32::INFINITY };
        let as_node = split[WAYS - 1].0 + area * NODE_COST;
        let mut plan = Plan { cost: [0.0; WAYS], left: [0; WAYS], is_leaf: as_leaf <= as_node, members };
        plan.cost[0] = as_leaf.min(as_node);
        for ways in 1..WAYS {
            let (cost, of_left) = split[ways - 1];
            let fewer = plan.cost[ways - 1];
            plan.cost[ways] = cost.min(fewer);
            plan.left[ways - 1] = if cost < fewer { of_left } else { 0 };
        }
        // A node has eight children to give, whatever that costs.
        plan.left[WAYS - 1] = split[WAYS - 1].1;
        plan
    }

    /// The children of the node that stands for a binary node.
    pub(super) fn children(&self, at: usize, chosen: &mut Vec<Chosen>) {
        chosen.clear();
        if self.plans[at].is_leaf {
            chosen.push(Chosen { binary: at, is_leaf: true });
            return;
        }
        self.distribute(at, WIDTH, chosen);
    }

    /// Adds the children that stand for both sides of `at`, at most `most` of them, two at least.
    fn distribute(&self, at: usize, most: usize, chosen: &mut Vec<Chosen>) {
        if let Some([left, right]) = self.sides(at) {
            let of_left = self.plans[at].left[most - 2] as usize;
            self.stand_for(left, of_left, chosen);
            self.stand_for(right, most - of_left, chosen);
        }
    }

    /// Adds the children that stand for `at`, at most `most` of them.
    fn stand_for(&self, at: usize, mut most: usize, chosen: &mut Vec<Chosen>) {
        let plan = &self.plans[at];
        while most > 1 && plan.left[most - 2] == 0 {
            most -= 1;
        }
        if most > 1 {
            self.distribute(at, most, chosen);
        } else {
            chosen.push(Chosen { binary: at, is_leaf: plan.is_leaf });
        }
    }

    /// The members below a binary node.
    pub(super) fn members(&self, at: usize, members: &mut Vec<u32>) {
        members.clear();
        let mut pending = vec![at];
        while let Some(at) = pending.pop() {
            let node = &self.binary.nodes[at];
            match self.sides(at) {
                Some([left, right]) => pending.extend([right, left]),
                None => {
                    let first = node.first_index as usize;
                    members.extend(&self.binary.primitive_indices[first..first + node.prim_count as usize]);
                }
            }
        }
    }
}
