//! Path tracing in steps, one scattering of every path of a slice at a time.

use crate::{
    Overlap, Part, Raster, Step,
    accel::{TREE, UNMASKED},
    caustics::{FOCUSED, SKETCH},
    irradiance::{BY_RECORDS, FACING, WEIGH},
};

pub(crate) static NUMBERS: Part = Part { name: "math/numbers", source: include_str!("../math/numbers.wgsl") };
pub(crate) static SCENE: Part =
    Part { name: "transport/scene", source: include_str!("../transport/scene.wgsl") };
pub(crate) static BSDF: Part =
    Part { name: "transport/bsdf", source: include_str!("../transport/bsdf.wgsl") };
pub(crate) static SURFACE: Part =
    Part { name: "transport/surface", source: include_str!("../transport/surface.wgsl") };
static PANES: Part = Part { name: "transport/panes", source: include_str!("../transport/panes.wgsl") };
static LIGHTS: Part = Part { name: "transport/lights", source: include_str!("../transport/lights.wgsl") };
static KNOWN: Part = Part { name: "path/known", source: include_str!("../path/known.wgsl") };
static OCTREE: Part = Part { name: "octree/look_up", source: include_str!("../octree/look_up.wgsl") };
static BY_OCTREE: Part = Part { name: "octree/asked", source: include_str!("../octree/asked.wgsl") };
static ALONE: Part = Part { name: "path/alone", source: include_str!("../path/alone.wgsl") };
pub(crate) static STATE: Part = Part { name: "path/state", source: include_str!("../path/state.wgsl") };
static FRESH: Part = Part { name: "path/fresh", source: include_str!("../path/fresh.wgsl") };
pub(crate) static PIXEL: Part = Part { name: "path/pixel", source: include_str!("../path/pixel.wgsl") };
static RAY: Part = Part { name: "path/ray", source: include_str!("../path/ray.wgsl") };

static PHOTON: Part = Part { name: "photons/photon", source: include_str!("../photons/photon.wgsl") };

static BEGIN_PHOTON_ENTRY: Part =
    Part { name: "photons/begin", source: include_str!("../photons/begin.wgsl") };
static FLY_ENTRY: Part = Part { name: "photons/fly", source: include_str!("../photons/fly.wgsl") };
pub(crate) static DRAWN: Part = Part { name: "path/drawn", source: include_str!("../path/drawn.wgsl") };
static PLANES_ENTRIES: Part = Part { name: "path/planes", source: include_str!("../path/planes.wgsl") };
static BEGIN_ENTRY: Part = Part { name: "path/begin", source: include_str!("../path/begin.wgsl") };
static BEGIN_RAY_ENTRY: Part =
    Part { name: "path/begin_ray", source: include_str!("../path/begin_ray.wgsl") };
static CLOSEST_ENTRY: Part = Part { name: "path/closest", source: include_str!("../path/closest.wgsl") };
static SHADE_ENTRY: Part = Part { name: "path/shade", source: include_str!("../path/shade.wgsl") };
pub(crate) static DISPATCH: Part =
    Part { name: "path/dispatch", source: include_str!("../path/dispatch.wgsl") };
static TURN_ENTRY: Part = Part { name: "path/turn", source: include_str!("../path/turn.wgsl") };
static HAND_OVER_ENTRY: Part =
    Part { name: "path/hand_over", source: include_str!("../path/hand_over.wgsl") };
static OCCLUDED_ENTRY: Part = Part { name: "path/occluded", source: include_str!("../path/occluded.wgsl") };

/// A step that shades: what paths bring, and what they ask for light.
macro_rules! shading {
    ($name:literal, $brings:ident, $($asked:ident),+) => {
        Step {
            name: $name,
            entry_point: "shade",
            parts: &[
                &NUMBERS, &SCENE, &BSDF, &SURFACE, &LIGHTS, &TREE, &STATE, &$brings, &SKETCH, &FOCUSED, &KNOWN,
                $(&$asked,)+
                &SHADE_ENTRY,
            ],
            workgroup_size: [64, 1, 1],
        }
    };
}

/// Begins a path for every pixel of a slice.
pub static PATH_BEGIN: Step = Step {
    name: "path/begin",
    entry_point: "begin",
    parts: &[&NUMBERS, &SCENE, &BSDF, &TREE, &STATE, &FRESH, &PIXEL, &BEGIN_ENTRY],
    workgroup_size: [64, 1, 1],
};

/// What the rays of paths that go on meet.
pub static PATH_CLOSEST: Step = Step {
    name: "path/closest",
    entry_point: "closest",
    parts: &[&NUMBERS, &SCENE, &TREE, &STATE, &CLOSEST_ENTRY],
    workgroup_size: [64, 1, 1],
};

/// What paths find where they have arrived, and how they go on.
pub static PATH_SHADE: Step = shading!("path/shade", PIXEL, ALONE);

/// The same, asking the light octree at the first diffuse surface.
pub static PATH_SHADE_BY_OCTREE: Step = shading!("path/shade_by_octree", PIXEL, OCTREE, BY_OCTREE);

/// The same, asking records of irradiance, and the octree where none counts.
pub static PATH_SHADE_BY_RECORDS: Step =
    shading!("path/shade_by_records", PIXEL, OCTREE, FACING, WEIGH, BY_RECORDS);

/// Swaps the queues of paths and says how much there is to do.
pub static PATH_TURN: Step = Step {
    name: "path/turn",
    entry_point: "turn",
    parts: &[&TREE, &UNMASKED, &STATE, &DISPATCH, &TURN_ENTRY],
    workgroup_size: [1, 1, 1],
};

/// Hands the last paths of a slice over, for others to follow.
pub static PATH_HAND_OVER: Step = Step {
    name: "path/hand_over",
    entry_point: "hand_over",
    parts: &[&TREE, &UNMASKED, &STATE, &HAND_OVER_ENTRY],
    workgroup_size: [64, 1, 1],
};

/// Adds the light samples that nothing hides, or panes alone.
pub static PATH_OCCLUDED: Step = Step {
    name: "path/occluded",
    entry_point: "occluded",
    parts: &[&NUMBERS, &SCENE, &BSDF, &SURFACE, &TREE, &PANES, &STATE, &PIXEL, &OCCLUDED_ENTRY],
    workgroup_size: [64, 1, 1],
};

/// Begins a path with every ray of a slice of those that light is gathered along.
pub static GATHER_BEGIN: Step = Step {
    name: "gather/begin",
    entry_point: "begin",
    parts: &[&NUMBERS, &SCENE, &BSDF, &TREE, &STATE, &FRESH, &RAY, &BEGIN_RAY_ENTRY],
    workgroup_size: [64, 1, 1],
};

/// [`PATH_SHADE`] for these.
pub static GATHER_SHADE: Step = shading!("gather/shade", RAY, ALONE);

/// [`PATH_SHADE_BY_OCTREE`] for these.
pub static GATHER_SHADE_BY_OCTREE: Step = shading!("gather/shade_by_octree", RAY, OCTREE, BY_OCTREE);

/// [`PATH_OCCLUDED`] for these.
pub static GATHER_OCCLUDED: Step = Step {
    name: "gather/occluded",
    entry_point: "occluded",
    parts: &[&NUMBERS, &SCENE, &BSDF, &SURFACE, &TREE, &PANES, &STATE, &RAY, &OCCLUDED_ENTRY],
    workgroup_size: [64, 1, 1],
};

/// Begins a path with every photon of a slice of those that are sent out.
pub static PHOTONS_BEGIN: Step = Step {
    name: "photons/begin",
    entry_point: "begin",
    parts: &[&NUMBERS, &SCENE, &BSDF, &TREE, &STATE, &FRESH, &PHOTON, &BEGIN_PHOTON_ENTRY],
    workgroup_size: [64, 1, 1],
};

/// What photons leave behind where they have arrived, and how they go on.
pub static PHOTONS_FLY: Step = Step {
    name: "photons/fly",
    entry_point: "fly",
    parts: &[&NUMBERS, &SCENE, &BSDF, &SURFACE, &TREE, &STATE, &PHOTON, &FLY_ENTRY],
    workgroup_size: [64, 1, 1],
};

/// Surfaces that the middles of pixels see, of many small pictures at once.
pub static PLANES: Raster = Raster {
    name: "path/planes",
    vertex: "corner",
    fragment: "seen",
    overlap: Overlap::Nearest,
    parts: &[&NUMBERS, &SCENE, &TREE, &DRAWN, &PLANES_ENTRIES],
};
