//! The tree over instances: built at once, kept up to date edit by edit.
//!
//! Instances that overlap would be walked one after the other from their roots, so the build *opens* the largest: in
//! place of an instance stand the subtrees of its mesh's tree [Benthin2017]. An instance that is alone stays whole, as
//! nothing overlaps it. A moved instance takes its subtrees along, an added one is put where it enlarges the tree least, a
//! removed one leaves its slots free: work in proportion to the instances touched and the tree's depth, besides a few
//! passes over plain lists. What that costs later rays is watched by the surface area heuristic.

use std::{
    collections::{BinaryHeap, HashMap},
    num::NonZeroU32,
    sync::Arc,
};

use obvhs::aabb::Aabb;

use super::{
    instance::Instance,
    layout::LeafOrder,
    node::{FREE, LEAF, WIDTH, WideNode},
    tree::{LeafKind, Tree},
};
use crate::scene::Id;

/// Opening stops at this share of the scene's half area: smaller subtrees overlap little.
const OPEN_SHARE: f32 = 1.0 / 4096.0;
/// Opening stops when the tree holds this many parts for each instance …
const PARTS_PER_INSTANCE: usize = 4;
/// … and one for so many triangles of all meshes, which keeps it at a sixth of the memory of theirs, and no more than so many: all
/// parts of what an edit moves are fitted …
const TRIANGLES_PER_PART: usize = 8;
const PARTS_MAX: usize = 8192;
/// … and this many in a small scene.
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
    /// Where the mesh's tree has it; `None` for the whole of it.
    below: Option<Place>,
    /// Where the top tree holds it; `None` for a part that was removed.
    at: Option<Place>,
}

/// A slot of a node of a tree.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Place(NonZeroU32);

impl Place {
    /// A tree has fewer nodes than 2²⁹: with so many it would take 128 GiB.
    fn new(node: u32, slot: usize) -> Place {
        Place(NonZeroU32::MIN.saturating_add(node * WIDTH as u32 + slot as u32))
    }

    fn node(self) -> u32 {
        (self.0.get() - 1) / WIDTH as u32
    }

    fn slot(self) -> usize {
        (self.0.get() - 1) as usize % WIDTH
    }
}

impl Part {
    /// Bounds in the mesh's space.
    fn bounds_in_mesh(&self, instance: &Instance) -> Aabb {
        bounds_in_mesh(instance, self.below)
    }
}

fn bounds_in_mesh(instance: &Instance, below: Option<Place>) -> Aabb {
    let tree = instance.bottom().tree();
    below.map_or(*tree.bounds(), |place| tree.node(place.node()).bounds(place.slot()))
}

/// Nothing leads to the root.
const ABOVE_ROOT: Place = Place(NonZeroU32::MIN);

/// See the module's head.
#[derive(Clone, Debug)]
pub(super) struct TopTree {
    tree: Tree,
    parts: Vec<Part>,
    /// Where walks start: the first node that has more than one child, or the part that is alone.
    start: u32,
    /// What leads to each node; the root's own is meaningless.
    parents: Vec<Place>,
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
    below: Option<Place>,
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
            .map(|part| Part { instance: part.instance, child: part.child, below: part.below, at: None })
            .collect();
        let mut parents = vec![ABOVE_ROOT; tree.nodes().len()];
        for (index, node) in tree.nodes().iter().enumerate() {
            for slot in node.used() {
                let at = Place::new(index as u32, slot);
                match node.child(slot) {
                    leaf if leaf & LEAF != 0 => parts[(leaf & !LEAF) as usize].at = Some(at),
                    child => parents[child as usize] = at,
                }
            }
        }
        let (cost_built, start) = (tree.sah_cost(), start_of(&tree));
        TopTree { tree, parts, start, parents, parts_of, cost_built, gone: 0 }
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
            + self.parts.len() * size_of::<Part>()
            + self.parents.len() * size_of::<Place>()
            + self.parts_of.len() * size_of::<(u32, u32)>()
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
        for number in self.parts_range(index) {
            let part = &self.parts[number];
            let Some(at) = part.at else { continue };
            let bounds = instance.box_in_render(&part.bounds_in_mesh(instance));
            self.tree.node_mut(at.node()).set(at.slot(), &bounds, LEAF | number as u32);
            self.fit_above(at.node());
        }
    }

    /// The instance is gone; its number is free.
    pub(super) fn remove(&mut self, index: u32) {
        for number in self.parts_range(index) {
            let Some(at) = self.parts[number].at.take() else { continue };
            self.gone += 1;
            self.tree.node_mut(at.node()).clear(at.slot());
            self.fit_above(at.node());
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
        let bounds = instance.box_in_render(&bounds_in_mesh(instance, None));
        let at = self.place_for(&bounds);
        self.parts.push(Part { instance: index, child: 0, below: None, at: Some(at) });
        self.tree.node_mut(at.node()).set(at.slot(), &bounds, LEAF | part);
        self.fit_above(at.node());
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
        for part in self.parts.iter_mut().filter(|part| part.at.is_some()) {
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
            let at = self.parents[node as usize];
            let union = self.tree.node(node).union();
            let above = self.tree.node_mut(at.node());
            let before = above.bounds(at.slot());
            if before.min == union.min && before.max == union.max {
                return;
            }
            // A node without children keeps its slot, with bounds that nothing enters.
            above.set(at.slot(), &union, node);
            node = at.node();
        }
    }

    /// A free slot in the node that grows least; a leaf makes room by becoming a node.
    fn place_for(&mut self, bounds: &Aabb) -> Place {
        if self.tree.nodes().is_empty() {
            self.tree.push(WideNode::EMPTY);
            self.parents.push(ABOVE_ROOT);
            return Place::new(0, 0);
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
                (Some(free), Some(best)) if growth(&best) >= bounds.half_area() => {
                    return Place::new(at, free);
                }
                (Some(free), None) => return Place::new(at, free),
                (_, Some(best)) if node.child(best) & LEAF == 0 => at = node.child(best),
                (Some(free), Some(_)) => return Place::new(at, free),
                (None, Some(best)) => return self.split(at, best),
                // Eight empty nodes below: the first has room.
                (None, None) => at = node.child(0),
            }
        }
    }

    /// Puts a node with room in the place of a leaf and returns its first free slot.
    fn split(&mut self, node: u32, slot: usize) -> Place {
        let (leaf, bounds) = (self.tree.node(node).child(slot), self.tree.node(node).bounds(slot));
        let mut below = WideNode::EMPTY;
        below.set(0, &bounds, leaf);
        let index = self.tree.push(below);
        self.parents.push(Place::new(node, slot));
        self.tree.node_mut(node).set(slot, &bounds, index);
        self.parts[(leaf & !LEAF) as usize].at = Some(Place::new(index, 0));
        Place::new(index, 1)
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
    let candidate = |index: u32, child: u32, below: Option<Place>| {
        let instance = &instances[index as usize];
        let bounds = instance.box_in_render(&bounds_in_mesh(instance, below));
        Candidate { half_area: bounds.half_area(), instance: index, child, below, bounds }
    };
    let mut heap: BinaryHeap<Candidate> =
        (0..instances.len() as u32).map(|index| candidate(index, 0, None)).collect();
    let all = heap.iter().map(|part| part.bounds).reduce(|a, b| a.union(&b));
    let smallest = all.map_or(0.0, |all| all.half_area() * OPEN_SHARE);
    // A lone instance stays whole: nothing overlaps it, and walks start in its own tree.
    let most = if instances.len() == 1 { 1 } else { parts_max(instances) };
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
            node.used()
                .map(|slot| candidate(part.instance, node.child(slot), Some(Place::new(part.child, slot)))),
        );
    }
    done.extend(heap.into_sorted_vec());
    done
}

/// Parts at most.
fn parts_max(instances: &[Arc<Instance>]) -> usize {
    let meshes: HashMap<&Id, usize> =
        instances.iter().map(|instance| (instance.mesh_id(), instance.mesh().triangles().len())).collect();
    let triangles: usize = meshes.values().sum();
    PARTS_MIN.max(PARTS_PER_INSTANCE * instances.len()).max((triangles / TRIANGLES_PER_PART).min(PARTS_MAX))
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
