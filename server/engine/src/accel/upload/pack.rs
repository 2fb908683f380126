//! A tree of exact boxes turned into compressed nodes [Ylitie2017, 3], and a triangle's plane.

use std::collections::HashMap;

use bytemuck::Zeroable;
use glam::{Vec3, Vec3A};
use obvhs::aabb::Aabb;

use super::{GpuNode, START_COUNT_SHIFT, START_IS_LEAF};
use crate::accel::{
    node::{LEAF, WIDTH},
    tree::Tree,
};

/// A packed tree; indices count from its own first node and member.
pub(super) struct PackedTree {
    /// Never empty: an empty tree has a root without children.
    pub(super) nodes: Vec<GpuNode>,
    /// Where each child of the tree, node or leaf, starts here, as a part names it.
    pub(super) starts: HashMap<u32, u32>,
    /// Entries that a walk may have waiting at once.
    pub(super) stack_need: usize,
}

/// Packs a tree; `append(leaf)` appends the leaf's members to the caller's list and says how many there are.
pub(super) fn pack(tree: &Tree, mut append: impl FnMut(u32) -> u8) -> PackedTree {
    let mut nodes = vec![GpuNode::zeroed()];
    let mut starts = HashMap::from([(0, 0)]);
    let (mut member_count, mut levels) = (0u32, 1);
    // Nodes below one node are given their places together. The one in the first slot is packed next, so that its
    // own children come soon after.
    let mut pending = vec![(0u32, 0usize, 1)];
    while let Some((source, at, level)) = pending.pop() {
        let Some(source) = tree.nodes().get(source as usize) else { break };
        levels = levels.max(level);
        let union = source.union();
        let mut node = frame_of(&union, source.used().count());
        node.member_base = member_count;
        node.child_base = nodes.len() as u32;
        for (slot, from) in slots_of(source.used().map(|from| (from, source.bounds(from))), &union) {
            let child = source.child(from);
            set_planes(&mut node, slot, &source.bounds(from));
            if child & LEAF == 0 {
                node.inner |= 1 << slot;
                let place = nodes.len();
                starts.insert(child, place as u32);
                pending.push((child, place, level + 1));
                nodes.push(GpuNode::zeroed());
            } else {
                let count = append(child & !LEAF);
                let packed = START_IS_LEAF | (u32::from(count) - 1) << START_COUNT_SHIFT | member_count;
                starts.insert(child, packed);
                member_count += u32::from(count);
            }
            let end = (member_count - node.member_base) as u8;
            node.member_ends[slot..].fill(end);
        }
        let inner_count = nodes.len() - node.child_base as usize;
        let children = pending.len() - inner_count;
        pending[children..].reverse();
        nodes[at] = node;
    }
    // Children of the root may wait, and so on down; the root itself never does.
    PackedTree { nodes, starts, stack_need: levels - 1 }
}

/// A node with origin and exponents for these bounds and nothing in it.
fn frame_of(union: &Aabb, child_count: usize) -> GpuNode {
    let mut node = GpuNode::zeroed();
    node.exponents = [1; 3];
    if child_count > 0 {
        node.origin = union.min.to_array();
        node.exponents = [0, 1, 2].map(|axis| exponent_for(union.min[axis], union.max[axis]));
    }
    node
}

/// The plane `steps` steps from `origin`: one rounding, as the product is exact.
pub(super) fn plane(origin: f32, exponent: u8, steps: u8) -> f32 {
    origin + f32::from(steps) * f32::from_bits(u32::from(exponent) << 23)
}

/// The smallest exponent with which 255 steps reach from `low` to `high`: rounding counts.
/// At least 1, as an f32 with exponent 0 is not a power of two.
pub(super) fn exponent_for(low: f32, high: f32) -> u8 {
    first(1, 254, |exponent| plane(low, exponent, 255) >= high)
}

/// The smallest number of `from..=to` for which `holds`, given that it then does for all larger ones; `to` if for none.
fn first(from: u8, to: u8, holds: impl Fn(u8) -> bool) -> u8 {
    let (mut from, mut to) = (from, to);
    while from < to {
        let middle = from + (to - from) / 2;
        if holds(middle) {
            to = middle;
        } else {
            from = middle + 1;
        }
    }
    from
}

/// Puts a box into a slot: each plane as near as it can be from outside.
fn set_planes(node: &mut GpuNode, slot: usize, bounds: &Aabb) {
    for axis in 0..3 {
        let at = |steps| plane(node.origin[axis], node.exponents[axis], steps);
        let (low, high) = (bounds.min[axis], bounds.max[axis]);
        let above = first(0, 255, |steps| at(steps) > low);
        // The origin is never above, and where even the last step is not, it is the nearest.
        let is_beyond = at(above) > low;
        node.planes[axis][0][slot] = if is_beyond { above.saturating_sub(1) } else { above };
        node.planes[axis][1][slot] = first(0, 255, |steps| at(steps) >= high);
    }
}

/// Slots for children, ascending: (slot, child). The bits of a slot say to which side of the node's middle its child
/// tends. Of all pairs of a free slot and a child without one that tends there most is joined first; the paper's auction
/// finds the best sum, this comes close at a tenth of the code.
fn slots_of(children: impl Iterator<Item = (usize, Aabb)>, union: &Aabb) -> Vec<(usize, usize)> {
    let middle = (union.min + union.max) * 0.5;
    let mut pairs: Vec<(f32, usize, usize)> = children
        .flat_map(|(child, bounds)| {
            let away = (bounds.min + bounds.max) * 0.5 - middle;
            (0..WIDTH).map(move |slot| {
                let side = Vec3A::from_array([1, 2, 4].map(|bit| if slot & bit == 0 { -1.0 } else { 1.0 }));
                (away.dot(side), slot, child)
            })
        })
        .collect();
    pairs.sort_by(|a, b| b.0.total_cmp(&a.0).then((a.1, a.2).cmp(&(b.1, b.2))));
    let mut joined: Vec<(usize, usize)> = Vec::with_capacity(WIDTH);
    for (_, slot, child) in pairs {
        if joined.iter().all(|pair| pair.0 != slot && pair.1 != child) {
            joined.push((slot, child));
        }
    }
    joined.sort_unstable();
    joined
}

/// The axis on which a triangle's normal is longest, 3 when it has none, and the normal along the two axes after it in
/// lengths of that: computed in double precision, where differences of corners and their products are as good as exact.
pub(super) fn plane_of(corners: [Vec3; 3]) -> (u32, [f32; 2]) {
    let [a, b, c] = corners.map(|corner| corner.as_dvec3());
    let normal = (b - a).cross(c - a);
    let axis = normal.abs().max_position();
    let longest = normal[axis];
    if longest == 0.0 {
        return (3, [0.0; 2]);
    }
    (axis as u32, [1, 2].map(|next| (normal[(axis + next) % 3] / longest) as f32))
}
