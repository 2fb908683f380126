//! Caustics: photons looked up in shading, and those of a sketch counted in the pixels of a picture for that.

use crate::{Part, Step};

pub(crate) static SKETCH: Part =
    Part { name: "caustics/sketch", source: include_str!("../caustics/sketch.wgsl") };
pub(crate) static FOCUSED: Part =
    Part { name: "caustics/look_up", source: include_str!("../caustics/look_up.wgsl") };
static COUNTING: Part = Part { name: "caustics/counting", source: include_str!("../caustics/counting.wgsl") };

static PLACE_ENTRY: Part = Part { name: "caustics/place", source: include_str!("../caustics/place.wgsl") };
static SUM_ROWS_ENTRY: Part =
    Part { name: "caustics/sum_rows", source: include_str!("../caustics/sum_rows.wgsl") };
static CHOOSE_ENTRY: Part = Part { name: "caustics/choose", source: include_str!("../caustics/choose.wgsl") };
static ALLOT_ENTRY: Part = Part { name: "caustics/allot", source: include_str!("../caustics/allot.wgsl") };
static FILL_ENTRY: Part = Part { name: "caustics/fill", source: include_str!("../caustics/fill.wgsl") };
static ORDER_ENTRY: Part = Part { name: "caustics/order", source: include_str!("../caustics/order.wgsl") };

/// A step of counting a sketch.
macro_rules! counting {
    ($entry_point:literal, $entry:ident) => {
        Step {
            name: concat!("caustics/", $entry_point),
            entry_point: $entry_point,
            parts: &[&SKETCH, &COUNTING, &$entry],
            workgroup_size: [64, 1, 1],
        }
    };
}

/// Finds the pixels that photons of a sketch show in, and counts them there.
pub static CAUSTICS_PLACE: Step = counting!("place", PLACE_ENTRY);

/// Adds them up along rows.
pub static CAUSTICS_SUM_ROWS: Step = counting!("sum_rows", SUM_ROWS_ENTRY);

/// Gives each photon a window as wide as it takes to hold some others, and counts it in the cells which that reaches into.
pub static CAUSTICS_CHOOSE: Step = counting!("choose", CHOOSE_ENTRY);

/// Gives each cell room for its photons.
pub static CAUSTICS_ALLOT: Step = counting!("allot", ALLOT_ENTRY);

/// Puts photons into their cells, as they come.
pub static CAUSTICS_FILL: Step = counting!("fill", FILL_ENTRY);

/// Puts those of each cell into their order.
pub static CAUSTICS_ORDER: Step = counting!("order", ORDER_ENTRY);
