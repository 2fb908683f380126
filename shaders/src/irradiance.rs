//! Records of irradiance: looked up in shading, and splatted onto what a picture sees.

use crate::{
    Overlap, Part, Raster, Step,
    accel::TREE,
    path::{BSDF, NUMBERS, SCENE, SURFACE},
};

pub(crate) static FACING: Part =
    Part { name: "irradiance/facing", source: include_str!("../irradiance/facing.wgsl") };
pub(crate) static WEIGH: Part =
    Part { name: "irradiance/weigh", source: include_str!("../irradiance/weigh.wgsl") };
pub(crate) static BY_RECORDS: Part =
    Part { name: "irradiance/look_up", source: include_str!("../irradiance/look_up.wgsl") };
static ANSWER: Part = Part { name: "irradiance/answer", source: include_str!("../irradiance/answer.wgsl") };
static PICTURE: Part =
    Part { name: "irradiance/picture", source: include_str!("../irradiance/picture.wgsl") };

static SEEN_ENTRY: Part = Part { name: "irradiance/seen", source: include_str!("../irradiance/seen.wgsl") };
static SPLAT_ENTRIES: Part =
    Part { name: "irradiance/splat", source: include_str!("../irradiance/splat.wgsl") };
static RESOLVE_ENTRY: Part =
    Part { name: "irradiance/resolve", source: include_str!("../irradiance/resolve.wgsl") };
static REACH_ENTRY: Part =
    Part { name: "irradiance/reach", source: include_str!("../irradiance/reach.wgsl") };
static SPLAT_TILES_ENTRY: Part =
    Part { name: "irradiance/splat_tiles", source: include_str!("../irradiance/splat_tiles.wgsl") };

/// Where the surfaces that a picture sees lie, and which way they face.
pub static IRRADIANCE_SEEN: Step = Step {
    name: "irradiance/seen",
    entry_point: "seen",
    parts: &[&NUMBERS, &SCENE, &BSDF, &SURFACE, &TREE, &FACING, &PICTURE, &SEEN_ENTRY],
    workgroup_size: [64, 1, 1],
};

/// Records added up in the pixels in which they may count.
pub static IRRADIANCE_SPLAT: Raster = Raster {
    name: "irradiance/splat",
    vertex: "corner",
    fragment: "splat",
    overlap: Overlap::Sum,
    parts: &[&NUMBERS, &SCENE, &FACING, &WEIGH, &PICTURE, &SPLAT_ENTRIES],
};

/// What they say there, and which pixels lack a record.
pub static IRRADIANCE_RESOLVE: Step = Step {
    name: "irradiance/resolve",
    entry_point: "resolve",
    parts: &[&PICTURE, &ANSWER, &RESOLVE_ENTRY],
    workgroup_size: [64, 1, 1],
};

/// How far records reach, for [`IRRADIANCE_SPLAT_TILES`].
pub static IRRADIANCE_REACH: Step = Step {
    name: "irradiance/reach",
    entry_point: "reach",
    parts: &[&NUMBERS, &SCENE, &FACING, &WEIGH, &REACH_ENTRY],
    workgroup_size: [64, 1, 1],
};

/// Records added up in the pixels in which they may count, a workgroup a tile of the picture, and what [`IRRADIANCE_RESOLVE`] finds out.
pub static IRRADIANCE_SPLAT_TILES: Step = Step {
    name: "irradiance/splat_tiles",
    entry_point: "splat_tiles",
    parts: &[&NUMBERS, &SCENE, &FACING, &WEIGH, &PICTURE, &ANSWER, &SPLAT_TILES_ENTRY],
    workgroup_size: [16, 8, 1],
};
