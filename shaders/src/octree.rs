//! Density estimates for the light octree: the nearest photons of gathers, and the surfaces that hold them.

use crate::{Part, Step};

static GATHER: Part = Part { name: "octree/gather", source: include_str!("../octree/gather.wgsl") };
static SEARCH_ENTRY: Part = Part { name: "octree/search", source: include_str!("../octree/search.wgsl") };
static EXTENT: Part = Part { name: "octree/extent", source: include_str!("../octree/extent.wgsl") };
static WITHIN_ENTRY: Part = Part { name: "octree/within", source: include_str!("../octree/within.wgsl") };

/// The nearest photons of gathers.
pub static OCTREE_SEARCH: Step = Step {
    name: "octree/search",
    entry_point: "search",
    parts: &[&GATHER, &SEARCH_ENTRY],
    workgroup_size: [64, 1, 1],
};

/// How much surface lies within the reach of each.
pub static OCTREE_WITHIN: Step = Step {
    name: "octree/within",
    entry_point: "within",
    parts: &[&GATHER, &EXTENT, &WITHIN_ENTRY],
    workgroup_size: [64, 1, 1],
};
