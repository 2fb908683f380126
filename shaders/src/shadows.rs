//! Maps of shadows: what lights without extent see, drawn and looked up.

use crate::{
    Overlap, Part, Raster, Step,
    accel::{TREE, UNMASKED},
    path::{DISPATCH, DRAWN, NUMBERS, PIXEL, SCENE, STATE},
};

static PLANE: Part = Part { name: "shadows/plane", source: include_str!("../shadows/plane.wgsl") };
static LOOK_UP: Part = Part { name: "shadows/look_up", source: include_str!("../shadows/look_up.wgsl") };
static ASK_ENTRY: Part = Part { name: "shadows/ask", source: include_str!("../shadows/ask.wgsl") };
static TURN_ENTRY: Part = Part { name: "shadows/turn", source: include_str!("../shadows/turn.wgsl") };
static MAP_ENTRIES: Part = Part { name: "shadows/map", source: include_str!("../shadows/map.wgsl") };

/// How near what lights see is.
pub static SHADOW_MAP: Raster = Raster {
    name: "shadows/map",
    vertex: "corner",
    fragment: "kept",
    overlap: Overlap::Nearness,
    parts: &[&NUMBERS, &SCENE, &TREE, &DRAWN, &PLANE, &MAP_ENTRIES],
};

/// Adds the light samples of pixels of which maps tell what arrives: the others are left to [`crate::PATH_OCCLUDED`].
pub static SHADOWS_ASK: Step = Step {
    name: "shadows/ask",
    entry_point: "ask",
    parts: &[&NUMBERS, &SCENE, &TREE, &STATE, &PIXEL, &PLANE, &LOOK_UP, &ASK_ENTRY],
    workgroup_size: [64, 1, 1],
};

/// Says how many those are.
pub static SHADOWS_TURN: Step = Step {
    name: "shadows/turn",
    entry_point: "turn_shadows",
    parts: &[&TREE, &UNMASKED, &STATE, &DISPATCH, &TURN_ENTRY],
    workgroup_size: [1, 1, 1],
};
