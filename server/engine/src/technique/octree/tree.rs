//! The octree's nodes: eight children each, found by the bits of a cell's place.

use glam::UVec3;

/// Marks a child that is a leaf.
pub(super) const LEAF: u32 = 1 << 31;
/// No surface there.
pub(super) const EMPTY: u32 = u32::MAX;

/// Nodes in depth-first order.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Nodes {
    pub(super) children: Vec<[u32; 8]>,
    depth: u32,
}

/// A node on the way down.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    node: u32,
    /// Levels above the leaves.
    height: u32,
}

impl Nodes {
    /// Over leaves by their Morton codes, ascending.
    pub(super) fn over(codes: &[u32], depth: u32) -> Nodes {
        let mut nodes = Nodes { children: Vec::new(), depth };
        if !codes.is_empty() {
            nodes.add(codes, 0, depth);
        }
        nodes
    }

    fn add(&mut self, codes: &[u32], first_leaf: u32, height: u32) -> u32 {
        let node = self.children.len();
        self.children.push([EMPTY; 8]);
        let shift = 3 * (height - 1);
        let mut at = 0;
        for octant in 0..8 {
            let end = at + codes[at..].partition_point(|code| code >> shift & 7 == octant);
            if end > at {
                let leaf = first_leaf + at as u32;
                let child =
                    if height == 1 { LEAF | leaf } else { self.add(&codes[at..end], leaf, height - 1) };
                self.children[node][octant as usize] = child;
            }
            at = end;
        }
        node as u32
    }

    /// The deepest node that holds both cells, neither of which is outside.
    #[inline]
    pub(super) fn common(&self, a: UVec3, b: UVec3) -> Option<Place> {
        let differing = (a.x ^ b.x) | (a.y ^ b.y) | (a.z ^ b.z);
        // The node above the highest differing bit; at least the leaves' parent.
        let height_end = (32 - differing.leading_zeros()).max(1);
        let mut place = Place { node: 0, height: self.depth };
        if self.children.is_empty() {
            return None;
        }
        while place.height > height_end {
            place = self.below(place, a)?;
        }
        Some(place)
    }

    #[inline]
    fn child(&self, place: Place, cell: UVec3) -> u32 {
        let bit = place.height - 1;
        let octant = cell.x >> bit & 1 | (cell.y >> bit & 1) << 1 | (cell.z >> bit & 1) << 2;
        self.children[place.node as usize][octant as usize]
    }

    #[inline]
    fn below(&self, place: Place, cell: UVec3) -> Option<Place> {
        let child = self.child(place, cell);
        (child != EMPTY).then(|| Place { node: child, height: place.height - 1 })
    }

    /// The leaf of a cell below a node that holds it.
    #[inline]
    pub(super) fn leaf(&self, mut place: Place, cell: UVec3) -> Option<usize> {
        while place.height > 1 {
            place = self.below(place, cell)?;
        }
        let child = self.child(place, cell);
        (child != EMPTY).then_some((child & !LEAF) as usize)
    }

    pub(super) fn bytes(&self) -> usize {
        self.children.len() * size_of::<[u32; 8]>()
    }
}

#[cfg(test)]
mod tests {
    use super::super::voxels::morton;
    use super::*;
    use crate::math::sobol::mix;

    /// Every cell that has a leaf is found by way of every node above it, no other is.
    #[test]
    fn leaves_are_found_and_nothing_else() {
        for depth in 1..=6u32 {
            let side = 1u32 << depth;
            let cells: Vec<UVec3> =
                (0..side.pow(3)).map(|i| UVec3::new(i % side, i / side % side, i / side / side)).collect();
            let holds = |cell: &UVec3| mix(u64::from(morton(*cell)) + 7).is_multiple_of(5);
            let mut codes: Vec<u32> =
                cells.iter().filter(|cell| holds(cell)).map(|cell| morton(*cell)).collect();
            codes.sort_unstable();
            let nodes = Nodes::over(&codes, depth);
            for (index, cell) in cells.iter().enumerate() {
                let expected = holds(cell).then(|| codes.binary_search(&morton(*cell)).unwrap());
                let other = cells[(index * 31 + 7) % cells.len()];
                let found = nodes.common(*cell, other).and_then(|place| nodes.leaf(place, *cell));
                assert_eq!(found, expected, "depth {depth} {cell}");
            }
        }
    }
}
