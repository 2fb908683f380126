//! The tree over instances: built at once, kept up to date edit by edit.
//!
//! Instances that overlap would be walked one after the other from their roots, so the build *opens* the largest: in
//! place of an instance stand the subtrees of its mesh's tree [Benthin2017]. An instance that is alone stays whole, as
//! nothing overlaps it. A moved instance takes its subtrees along, an added one is put where it enlarges the tree least, a
//! removed one leaves its slots free: work in proportion to the instances touched and the tree's depth, besides a few
//! passes over plain lists. What that costs later rays is watched by the surface area heuristic.

use std::{collections::BinaryHeap, sync::Arc};

use obvhs::aabb::Aabb;

use super::{
    instance::Instance,
    layout::LeafOrder,
    node::{FREE, LEAF, WIDTH, WideNode},
    tree::{LeafKind, Tree},
};

/// Opening stops at this share of the scene's half area: smaller subtrees overlap little.
const OPEN_SHARE: f32 = 1.0 / 256.0;
/// Opening stops when the tree holds this many parts for each instance …
const PARTS_PER_INSTANCE: usize = 4;
/// … or this many in a small scene.
const PARTS_MIN: usize = 512;
/// A tree whose cost has grown by this factor over edits is worth building again.
const WORN: f32 = 1.3;
/// One whose cost has grown by this factor is built again at once: edits come faster than it is restored.
const WORN_OUT: f32 = 2.0;

/// The same for the share of parts that are gone and only take up room.
const GONE_WORN: f32 = 0.5;
const GONE_OUT: f32 = 0.75;

/// How much worse edits have made a tree than it was when it was built.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Wear {
    /// Not worth a thought.
    Little,
    /// Worth building again in the background.
    Worn,
    /// Not fit for use.
    Out,
}

/// A subtree of an instance's mesh, as the top tree's leaves name it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Part {
    pub(super) instance: u32,
    /// A child of the mesh's tree: a node or a leaf.
    pub(super) child: u32,
    /// Where the top tree holds it; the node is `GONE` for a part that was removed.
    node: u32,
    slot: u32,
}

const GONE: u32 = u32::MAX;

/// See the module's head.
#[derive(Clone, Debug)]
pub(super) struct TopTree {
    tree: Tree,
    parts: Vec<Part>,
    /// Where walks start: the first node that has more than one child, or the part that is alone.
    start: u32,
    /// Bounds of each part in its mesh's space.
    boxes: Vec<Aabb>,
    /// Node and slot that lead to each node; the root's own is meaningless.
    parents: Vec<(u32, u32)>,
    /// Per instance, the first of its parts and how many there are: they lie side by side.
    parts_of: Vec<(u32, u32)>,
    /// Cost when it was built.
    cost_built: f32,
    /// Parts that were removed.
    gone: usize,
}

/// A part that may be opened, largest first.
struct Candidate {
    half_area: f32,
    instance: u32,
    child: u32,
    /// In the mesh's space.
    local: Aabb,
    /// In render space.
    bounds: Aabb,
}

impl TopTree {
    pub(super) fn build(instances: &[Arc<Instance>]) -> TopTree {
        let mut found = open(instances);
        // Parts of an instance lie side by side; the order within is the build's and the same on every run.
        found.sort_by_key(|candidate| candidate.instance);
        let bounds: Vec<Aabb> = found.iter().map(|candidate| candidate.bounds).collect();
        let mut parts_of = vec![(0, 0); instances.len()];
        for (index, candidate) in found.iter().enumerate() {
            let (first, count) = &mut parts_of[candidate.instance as usize];
            if *count == 0 {
                *first = index as u32;
            }
            *count += 1;
        }
        let (mut tree, order) = Tree::build(&bounds, LeafKind { members_max: 1, cost: 1.0 });
        tree.rename_leaves(|leaf| order.members[LeafOrder::range_of(leaf).0]);
        let mut parts: Vec<Part> = found
            .iter()
            .map(|part| Part { instance: part.instance, child: part.child, node: GONE, slot: 0 })
            .collect();
        let mut parents = vec![(0, 0); tree.nodes().len()];
        for (index, node) in tree.nodes().iter().enumerate() {
            for slot in node.used() {
                let at = (index as u32, slot as u32);
                match node.child(slot) {
                    leaf if leaf & LEAF != 0 => {
                        let part = &mut parts[(leaf & !LEAF) as usize];
                        (part.node, part.slot) = at;
                    }
                    child => parents[child as usize] = at,
                }
            }
        }
        let boxes = found.iter().map(|part| part.local).collect();
        let (cost_built, start) = (tree.sah_cost(), start_of(&tree));
        TopTree { tree, parts, start, boxes, parents, parts_of, cost_built, gone: 0 }
    }

    pub(super) fn tree(&self) -> &Tree {
        &self.tree
    }

    /// Where a walk starts.
    #[inline(always)]
    pub(super) fn start(&self) -> u32 {
        self.start
    }

    /// The part that a leaf names.
    #[inline(always)]
    pub(super) fn part(&self, leaf: u32) -> Part {
        self.parts[leaf as usize]
    }

    pub(super) fn bytes(&self) -> usize {
        self.tree.bytes()
            + self.parts.len() * (size_of::<Part>() + size_of::<Aabb>())
            + (self.parents.len() + self.parts_of.len()) * size_of::<(u32, u32)>()
    }

    /// What visiting it costs now, relative to when it was built.
    pub(super) fn growth(&self) -> f32 {
        self.tree.sah_cost() / self.cost_built.max(f32::MIN_POSITIVE)
    }

    /// How much worse edits have made it.
    pub(super) fn wear(&self) -> Wear {
        let growth = self.growth();
        let gone = self.gone as f32 / self.parts.len().max(1) as f32;
        if growth > WORN_OUT || gone > GONE_OUT {
            Wear::Out
        } else if growth > WORN || gone > GONE_WORN {
            Wear::Worn
        } else {
            Wear::Little
        }
    }

    /// The instance stands elsewhere: its parts' bounds are fitted, and those above them.
    pub(super) fn refit(&mut self, index: u32, instance: &Instance) {
        for part in self.parts_range(index) {
            let Part { node, slot, .. } = self.parts[part];
            let bounds = instance.box_in_render(&self.boxes[part]);
            self.tree.node_mut(node).set(slot as usize, &bounds, LEAF | part as u32);
            self.fit_above(node);
        }
    }

    /// The instance is gone; its number is free.
    pub(super) fn remove(&mut self, index: u32) {
        for part in self.parts_range(index) {
            let Part { node, slot, .. } = self.parts[part];
            self.parts[part].node = GONE;
            self.gone += 1;
            self.tree.node_mut(node).clear(slot as usize);
            self.fit_above(node);
        }
        self.parts_of[index as usize] = (0, 0);
    }

    /// An instance that has just come, as one part. Its number must be the next or free.
    pub(super) fn insert(&mut self, index: u32, instance: &Instance) {
        let part = self.parts.len() as u32;
        if self.parts_of.len() <= index as usize {
            self.parts_of.resize(index as usize + 1, (0, 0));
        }
        self.parts_of[index as usize] = (part, 1);
        let local = *instance.bottom().tree().bounds();
        let bounds = instance.box_in_render(&local);
        let (node, slot) = self.place_for(&bounds);
        self.parts.push(Part { instance: index, child: 0, node, slot });
        self.boxes.push(local);
        self.tree.node_mut(node).set(slot as usize, &bounds, LEAF | part);
        self.fit_above(node);
    }

    /// Instances have new numbers: `number[old]`, for those that stayed.
    pub(super) fn renumber(&mut self, number: &[Option<u32>], count: usize) {
        let mut parts_of = vec![(0, 0); count];
        for (old, new) in number.iter().enumerate() {
            if let (Some(new), Some(range)) = (new, self.parts_of.get(old)) {
                parts_of[*new as usize] = *range;
            }
        }
        self.parts_of = parts_of;
        for part in self.parts.iter_mut().filter(|part| part.node != GONE) {
            if let Some(Some(new)) = number.get(part.instance as usize) {
                part.instance = *new;
            }
        }
    }

    /// To be called after the last change of an edit.
    pub(super) fn finish(&mut self) {
        self.tree.finish_edit();
        self.start = start_of(&self.tree);
    }

    fn parts_range(&self, index: u32) -> std::ops::Range<usize> {
        let (first, count) = self.parts_of[index as usize];
        first as usize..(first + count) as usize
    }

    /// Fits the bounds of a node in its parent, and so on up.
    fn fit_above(&mut self, mut node: u32) {
        while node != 0 {
            let (parent, slot) = self.parents[node as usize];
            let union = self.tree.node(node).union();
            let above = self.tree.node_mut(parent);
            let before = above.bounds(slot as usize);
            if before.min == union.min && before.max == union.max {
                return;
            }
            // A node without children keeps its slot, with bounds that nothing enters.
            above.set(slot as usize, &union, node);
            node = parent;
        }
    }

    /// A free slot in the node that grows least; a leaf makes room by becoming a node.
    fn place_for(&mut self, bounds: &Aabb) -> (u32, u32) {
        if self.tree.nodes().is_empty() {
            self.tree.push(WideNode::EMPTY);
            self.parents.push((0, 0));
            return (0, 0);
        }
        let mut at = 0u32;
        loop {
            let node = self.tree.node(at);
            let growth = |slot: &usize| {
                let child = node.bounds(*slot);
                child.union(bounds).half_area() - child.half_area()
            };
            let free = (0..WIDTH).find(|slot| node.is_free(*slot) && node.child(*slot) == FREE);
            let best = node.used().min_by(|a, b| growth(a).total_cmp(&growth(b)));
            match (free, best) {
                (Some(free), Some(best)) if growth(&best) >= bounds.half_area() => return (at, free as u32),
                (Some(free), None) => return (at, free as u32),
                (_, Some(best)) if node.child(best) & LEAF == 0 => at = node.child(best),
                (Some(free), Some(_)) => return (at, free as u32),
                (None, Some(best)) => return self.split(at, best),
                // Eight empty nodes below: the first has room.
                (None, None) => at = node.child(0),
            }
        }
    }

    /// Puts a node with room in the place of a leaf and returns its first free slot.
    fn split(&mut self, node: u32, slot: usize) -> (u32, u32) {
        let (leaf, bounds) = (self.tree.node(node).child(slot), self.tree.node(node).bounds(slot));
        let mut below = WideNode::EMPTY;
        below.set(0, &bounds, leaf);
        let index = self.tree.push(below);
        self.parents.push((node, slot as u32));
        self.tree.node_mut(node).set(slot, &bounds, index);
        let part = &mut self.parts[(leaf & !LEAF) as usize];
        (part.node, part.slot) = (index, 0);
        (index, 1)
    }
}

/// The root, or what lies below while there is but one way to go.
fn start_of(tree: &Tree) -> u32 {
    let mut start = 0;
    while let Some(node) = tree.nodes().get(start as usize) {
        let mut used = node.used();
        match (used.next(), used.next()) {
            (Some(slot), None) => start = node.child(slot),
            _ => break,
        }
    }
    start
}

/// The instances' parts after the largest were opened.
fn open(instances: &[Arc<Instance>]) -> Vec<Candidate> {
    let candidate = |index: usize, child: u32, local: Aabb| {
        let bounds = instances[index].box_in_render(&local);
        Candidate { half_area: bounds.half_area(), instance: index as u32, child, local, bounds }
    };
    let mut heap: BinaryHeap<Candidate> = instances
        .iter()
        .enumerate()
        .map(|(index, instance)| candidate(index, 0, *instance.bottom().tree().bounds()))
        .collect();
    let all = heap.iter().map(|part| part.bounds).reduce(|a, b| a.union(&b));
    let smallest = all.map_or(0.0, |all| all.half_area() * OPEN_SHARE);
    // A lone instance stays whole: nothing overlaps it, and walks start in its own tree.
    let most = if instances.len() == 1 { 1 } else { PARTS_MIN.max(PARTS_PER_INSTANCE * instances.len()) };
    let mut done = Vec::new();
    while heap.len() + done.len() < most {
        let Some(part) = heap.pop() else { break };
        if part.half_area < smallest {
            heap.push(part);
            break;
        }
        if part.child & LEAF != 0 {
            done.push(part);
            continue;
        }
        let instance = &instances[part.instance as usize];
        let node = instance.bottom().tree().node(part.child);
        heap.extend(
            node.used().map(|slot| candidate(part.instance as usize, node.child(slot), node.bounds(slot))),
        );
    }
    done.extend(heap.into_sorted_vec());
    done
}

impl Ord for Candidate {
    fn cmp(&self, other: &Candidate) -> std::cmp::Ordering {
        let key = |part: &Candidate| (part.instance, part.child);
        self.half_area.total_cmp(&other.half_area).then_with(|| key(other).cmp(&key(self)))
    }
}

impl PartialOrd for Candidate {
    fn partial_cmp(&self, other: &Candidate) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Candidate {
    fn eq(&self, other: &Candidate) -> bool {
        self.cmp(other).is_eq()
    }
}

impl Eq for Candidate {}
