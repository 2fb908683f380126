//! What planes before points see, by rasterisation.

use crate::{
    Part, Raster,
    accel::TREE,
    path::{NUMBERS, SCENE},
};

static ENTRIES: Part = Part { name: "accel/planes", source: include_str!("../accel/planes.wgsl") };

/// Surfaces that the middles of pixels see, of many small pictures at once.
pub static PLANES: Raster = Raster {
    name: "accel/planes",
    vertex: "corner",
    fragment: "seen",
    parts: &[&NUMBERS, &SCENE, &TREE, &ENTRIES],
};
