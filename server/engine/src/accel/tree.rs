//! A tree of eight children a node: built by obvhs as a binary tree, collapsed, and walked front to back for the nearest
//! hit or largest child first for any hit.

use std::time::Duration;

use fearless_simd::Simd;
use glam::Vec3A;
use obvhs::{
    BvhBuildParams,
    aabb::Aabb,
    bvh2::{Bvh2, builder::build_bvh2},
    ploc::PlocSearchDistance,
};
use rayon::prelude::*;

use super::{
    collapse::Collapse,
    layout::{Layout, LeafOrder},
    node::{LEAF, Slab, WIDTH, WideNode},
    stack::Entry,
};

/// Smaller trees are laid out by one thread, and passes over members give each thread at least as many, so that they are
/// shared out from twice as many on. One thread builds a tree of so many in 3 ms (Sponza's 66,453 take it 27 ms), so there
/// is little to gain; and of small meshes there are mostly many, which keep the threads busy as they are.
pub(super) const PARALLEL_MIN: usize = 8192;

/// A tree over leaves that its owner knows by number.
#[derive(Clone, Debug)]
pub(super) struct Tree {
    nodes: Vec<WideNode>,
    bounds: Aabb,
    /// Entries that a walk may have waiting at once.
    stack_need: usize,
}

/// What waits in a walk front to back: the bits of the distance at which the ray enters a node or leaf, and below them
/// which it is. Distances are never negative, so their bits order as they do, and one comparison sorts.
#[inline(always)]
fn entry(t_near_bits: i32, child: u32) -> Entry {
    u64::from(t_near_bits as u32) << 32 | u64::from(child)
}

/// What the leaves of a tree are.
#[derive(Clone, Copy, Debug)]
pub(super) struct LeafKind {
    /// Most members of a leaf.
    pub(super) members_max: u32,
    /// What a leaf costs a ray, in visits of a node.
    pub(super) cost: f32,
}

/// The binary tree over `bounds`, members one by one in its leaves.
pub(super) fn build_binary(bounds: &[Aabb]) -> Bvh2 {
    // Half the time of obvhs's medium preset, for trees that cost rays 2 % more: its second round of reinsertion is meant for
    // trees whose leaves it has merged, which we do better ourselves. Pairs are sought among 6 neighbours instead of 14, but
    // from the third round on instead of the fourth: quicker, and Sponza, dragon and boulder cost 0.1 to 1.4 % less.
    let params = BvhBuildParams {
        max_prims_per_leaf: 1,
        ploc_search_distance: PlocSearchDistance::Low,
        search_depth_threshold: 2,
        post_collapse_reinsertion_batch_ratio_multiplier: 0.0,
        ..BvhBuildParams::medium_build()
    };
    let boxes: Vec<Aabb> = bounds.par_iter().with_min_len(PARALLEL_MIN).enumerate().map(told_apart).collect();
    build_bvh2(&boxes, params, &mut Duration::default())
}

/// The bounds of one member, larger by little and by another little for each member.
///
/// PLOC pairs boxes that are each other's best partner. Among boxes that are all alike, or alike and in a row, every one
/// takes the next for its best and one pair a round is found: 16,000 of them took seconds, a million hours. Boxes that
/// grow steadily from one to the next, by more than this hides, are still built so.
fn told_apart((index, bounds): (usize, &Aabb)) -> Aabb {
    // Multipliers that scatter neighbouring numbers over all bits: 2³² over the golden ratio [Knuth1998, 6.4] and the first
    // of MurmurHash3's last step; any hash would do.
    let mut bits = (index as u32).wrapping_mul(0x9e37_79b9);
    bits = (bits ^ bits >> 16).wrapping_mul(0x85eb_ca6b);
    bits ^= bits >> 13;
    // 2⁻²¹ of a coordinate are 4 to 8 of its roundings: fewer would be the same for too many. 2⁻¹⁴ of the size, where it
    // is more, make steps of 2⁻¹⁹: areas then differ by 16 of their roundings, and are larger by 0.03 % at most. The
    // square of 10⁻¹⁷ m, and of a 32nd of it, is still a number: areas of smaller boxes would all round to zero.
    let room = bounds.min.abs().max(bounds.max.abs()) * 0.5f32.powi(21) + bounds.diagonal() * 0.5f32.powi(14);
    let room = room.max(Vec3A::splat(1e-17));
    let share = |shift: u32| (bits >> shift & 0x1f) as f32 / 32.0;
    let [low, high] = [[0, 5, 10], [15, 20, 25]].map(|shifts| room * Vec3A::from_array(shifts.map(share)));
    Aabb { min: bounds.min - low, max: bounds.max + high }
}

impl Tree {
    /// Of some members by their bounds. The leaves are named by where their members lie in the order that comes with it.
    pub(super) fn build(bounds: &[Aabb], leaves: LeafKind) -> (Tree, LeafOrder) {
        let mut tree = Tree { nodes: Vec::new(), bounds: Aabb::INVALID, stack_need: 1 };
        if bounds.is_empty() {
            return (tree, LeafOrder::default());
        }
        let binary = build_binary(bounds);
        tree.bounds = *binary.nodes[0].aabb();
        let Layout { nodes, order } = Layout::of(&binary, &Collapse::choose(&binary, leaves));
        tree.nodes = nodes;
        // Small trees are laid out without knowing how many nodes they will have.
        tree.nodes.shrink_to_fit();
        tree.stack_need = tree.measure_stack_need();
        (tree, order)
    }

    /// Gives its leaves other names.
    pub(super) fn rename_leaves(&mut self, name: impl Fn(u32) -> u32) {
        for node in &mut self.nodes {
            node.lead_to(|child| if child & LEAF == 0 { child } else { LEAF | name(child & !LEAF) });
        }
    }

    /// Room for all children of every node on the longest way down, and of one more node. Free slots count, and so do nodes
    /// that edits have emptied: a ray of numbers that are none may enter what nothing enters.
    fn measure_stack_need(&self) -> usize {
        // Children come after their parents, so one pass from the end sees every child before its parent.
        let mut need = vec![0usize; self.nodes.len()];
        for (index, node) in self.nodes.iter().enumerate().rev() {
            // Leaves and free slots lead past the end.
            let below = (0..WIDTH).filter_map(|slot| need.get(node.child(slot) as usize));
            need[index] = WIDTH + below.max().copied().unwrap_or(0);
        }
        need.first().map_or(1, |need| need + WIDTH)
    }

    /// Bounds of everything in it.
    pub(super) fn bounds(&self) -> &Aabb {
        &self.bounds
    }

    pub(super) fn nodes(&self) -> &[WideNode] {
        &self.nodes
    }

    pub(super) fn node(&self, index: u32) -> &WideNode {
        &self.nodes[index as usize]
    }

    /// For edits, which end with [`Tree::finish_edit`].
    pub(super) fn node_mut(&mut self, index: u32) -> &mut WideNode {
        &mut self.nodes[index as usize]
    }

    /// Adds a node behind its parent and returns its index.
    pub(super) fn push(&mut self, node: WideNode) -> u32 {
        self.nodes.push(node);
        self.nodes.len() as u32 - 1
    }

    /// Brings bounds and stack into step with the nodes.
    pub(super) fn finish_edit(&mut self) {
        self.bounds = self.nodes.first().map_or(Aabb::INVALID, WideNode::union);
        self.stack_need = self.measure_stack_need();
    }

    /// Entries that a walk may have waiting at once.
    pub(super) fn stack_need(&self) -> usize {
        self.stack_need
    }

    /// Nodes and leaves that a ray through the bounds visits in the mean [MacDonald1990]: the surface area heuristic with
    /// cost 1 for a node and 1 for a leaf, as Embree counts its own trees.
    pub(super) fn sah_cost(&self) -> f32 {
        let root = self.bounds.half_area();
        if root <= 0.0 {
            return self.nodes.len() as f32;
        }
        let children: f32 =
            self.nodes.iter().flat_map(|node| node.used().map(|slot| node.bounds(slot).half_area())).sum();
        1.0 + children / root
    }

    pub(super) fn bytes(&self) -> usize {
        self.nodes.len() * size_of::<WideNode>()
    }

    /// Walks the leaves below `start` that `slab` enters before `t_max` and calls `visit` with each leaf and the unused
    /// part of the stack. `visit` may lower `t_max`, which must not be NaN, and ends the walk by returning true. Nearer
    /// children come first where `NEAREST_FIRST`; otherwise larger ones do, for where any hit will do, sorting costs more
    /// than it saves.
    #[inline(always)]
    pub(super) fn walk<S: Simd, const NEAREST_FIRST: bool>(
        &self,
        simd: S,
        start: u32,
        slab: &Slab,
        t_max: &mut f32,
        stack: &mut [Entry],
        visit: impl FnMut(u32, &mut f32, &mut [Entry]) -> bool,
    ) -> bool {
        if NEAREST_FIRST {
            self.walk_nearest_first(simd, start, slab, t_max, stack, visit)
        } else {
            self.walk_largest_first(simd, start, slab, t_max, stack, visit)
        }
    }

    /// Higher slots come first: in nodes that were built these hold the larger children, which are the likelier to be hit.
    /// Edits put children where there is room, which costs time but no answers. What waits is a node with the bit mask of
    /// its children that are still to be visited.
    #[inline(always)]
    fn walk_largest_first<S: Simd>(
        &self,
        simd: S,
        start: u32,
        slab: &Slab,
        t_max: &mut f32,
        stack: &mut [Entry],
        mut visit: impl FnMut(u32, &mut f32, &mut [Entry]) -> bool,
    ) -> bool {
        let mut child = start;
        let mut height = 0;
        let (mut node, mut index, mut waiting) = (&WideNode::EMPTY, 0, 0);
        loop {
            if child & LEAF == 0 {
                let Some(below) = self.nodes.get(child as usize) else { return false };
                let (entered, _) = below.enter(simd, slab, *t_max);
                if entered != 0 {
                    if waiting != 0 {
                        stack[height] = u64::from(index) << 32 | u64::from(waiting);
                        height += 1;
                    }
                    (node, index, waiting) = (below, child, entered);
                }
            } else if visit(child & !LEAF, t_max, &mut stack[height..]) {
                return true;
            }
            if waiting == 0 {
                if height == 0 {
                    return false;
                }
                height -= 1;
                (index, waiting) = ((stack[height] >> 32) as u32, stack[height] as u32);
                node = &self.nodes[index as usize];
            }
            let slot = waiting.ilog2();
            waiting ^= 1 << slot;
            child = node.child(slot as usize);
        }
    }

    #[inline(always)]
    fn walk_nearest_first<S: Simd>(
        &self,
        simd: S,
        start: u32,
        slab: &Slab,
        t_max: &mut f32,
        stack: &mut [Entry],
        mut visit: impl FnMut(u32, &mut f32, &mut [Entry]) -> bool,
    ) -> bool {
        let mut child = start;
        let mut height = 0;
        loop {
            if child & LEAF == 0 {
                let Some(node) = self.nodes.get(child as usize) else { return false };
                let (mut entered, t_near) = node.enter(simd, slab, *t_max);
                if entered != 0 {
                    let slot = entered.trailing_zeros() as usize;
                    entered &= entered - 1;
                    child = node.child(slot);
                    if entered == 0 {
                        continue;
                    }
                    let t_near: [i32; WIDTH] = t_near.into();
                    let first = entry(t_near[slot], child);
                    let slot = entered.trailing_zeros() as usize;
                    entered &= entered - 1;
                    let second = entry(t_near[slot % WIDTH], node.child(slot));
                    // Two children or three are sorted without a branch, as no processor can guess which there are: where
                    // there is no third, one farther than all stands for it and is not pushed.
                    let has_third = entered != 0;
                    let slot = entered.trailing_zeros() as usize % WIDTH;
                    entered &= entered.wrapping_sub(1);
                    let none = Entry::from(!has_third).wrapping_neg();
                    let third = entry(t_near[slot], node.child(slot)) | none;
                    let (near, far) = (first.min(second), first.max(second));
                    let (mut nearest, middle, farthest) =
                        (near.min(third), near.max(third).min(far), far.max(third));
                    let bottom = height;
                    stack[height..height + 2].copy_from_slice(&[farthest & !none | middle & none, middle]);
                    height += 1 + usize::from(has_third);
                    while entered != 0 {
                        let slot = entered.trailing_zeros() as usize;
                        entered &= entered - 1;
                        let next = entry(t_near[slot % WIDTH], node.child(slot));
                        let farther = nearest.max(next);
                        nearest = nearest.min(next);
                        // Insertion keeps nearer ones on top.
                        let mut at = height;
                        while at > bottom && stack[at - 1] < farther {
                            stack[at] = stack[at - 1];
                            at -= 1;
                        }
                        stack[at] = farther;
                        height += 1;
                    }
                    child = nearest as u32;
                    continue;
                }
            } else if visit(child & !LEAF, t_max, &mut stack[height..]) {
                return true;
            }
            loop {
                if height == 0 {
                    return false;
                }
                height -= 1;
                if f32::from_bits((stack[height] >> 32) as u32) <= *t_max {
                    break;
                }
            }
            child = stack[height] as u32;
        }
    }
}
