//! Rays against the two-level tree.

use crate::{Part, Step};

/// Structs, bindings and walks of the trees: `Ray`, `Hit`, `closest_hit`, `is_occluded`. Takes group 0, bindings 0 to 5,
/// the constants `STACK_SIZE` and `HAS_MASKS`, and another part's `is_present`.
pub static TREE: Part = Part { name: "accel/tree", source: include_str!("../accel/tree.wgsl") };

/// `is_present` for steps in whose scenes nothing is cut out by a mask.
pub static UNMASKED: Part = Part { name: "accel/unmasked", source: include_str!("../accel/unmasked.wgsl") };

static CLOSEST_ENTRY: Part = Part { name: "accel/closest", source: include_str!("../accel/closest.wgsl") };
static OCCLUDED_ENTRY: Part = Part { name: "accel/occluded", source: include_str!("../accel/occluded.wgsl") };

/// The nearest surface along every ray of a buffer.
pub static CLOSEST: Step = Step {
    name: "accel/closest",
    entry_point: "closest",
    parts: &[&TREE, &UNMASKED, &CLOSEST_ENTRY],
    workgroup_size: [64, 1, 1],
};

/// Whether anything lies on every ray of a buffer.
pub static OCCLUDED: Step = Step {
    name: "accel/occluded",
    entry_point: "occluded",
    parts: &[&TREE, &UNMASKED, &OCCLUDED_ENTRY],
    workgroup_size: [64, 1, 1],
};
