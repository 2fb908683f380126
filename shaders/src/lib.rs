//! Lumicast's shaders: WGSL in a folder for each room of the engine, embedded here and proved by naga in tests.
//!
//! A [`Part`] is a file. A [`Step`] is what runs: an entry point and the parts that it needs, one after the other; WGSL
//! itself knows no includes. Constants that Rust knows better are prepended, so that no number is written down twice.
//! Imports nothing: the engine takes texts from here and hands them to its graphics interface.

mod accel;
mod caustics;
mod film;
mod irradiance;
mod octree;
mod path;
mod shadows;

#[cfg(test)]
mod tests;

pub use accel::{CLOSEST, OCCLUDED, TREE, UNMASKED};
pub use caustics::{
    CAUSTICS_ALLOT, CAUSTICS_CHOOSE, CAUSTICS_FILL, CAUSTICS_ORDER, CAUSTICS_PLACE, CAUSTICS_SUM_ROWS,
};
pub use film::{
    FILM_BRIGHTEST, FILM_FIRST_SHOWN, FILM_JOINED, FILM_KNOWN_BETTER, FILM_PER_DIFFERENCE, FILM_SHOW,
    FILM_UNJOINED,
};
pub use irradiance::{
    IRRADIANCE_REACH, IRRADIANCE_RESOLVE, IRRADIANCE_SEEN, IRRADIANCE_SPLAT, IRRADIANCE_SPLAT_TILES,
};
pub use octree::{OCTREE_SEARCH, OCTREE_WITHIN};
pub use path::{
    GATHER_BEGIN, GATHER_OCCLUDED, GATHER_SHADE, GATHER_SHADE_BY_OCTREE, PATH_BEGIN, PATH_CLOSEST,
    PATH_HAND_OVER, PATH_OCCLUDED, PATH_SHADE, PATH_SHADE_BY_OCTREE, PATH_SHADE_BY_RECORDS, PATH_TURN,
    PHOTONS_BEGIN, PHOTONS_FLY, PLANES,
};
pub use shadows::{SHADOW_MAP, SHADOWS_ASK, SHADOWS_TURN};

/// Every step there is, in the order of rooms; a test parses and validates each.
pub static STEPS: &[&Step] = &[
    &CLOSEST,
    &OCCLUDED,
    &FILM_SHOW,
    &FILM_KNOWN_BETTER,
    &FILM_PER_DIFFERENCE,
    &FILM_JOINED,
    &FILM_BRIGHTEST,
    &FILM_UNJOINED,
    &FILM_FIRST_SHOWN,
    &PATH_BEGIN,
    &PATH_CLOSEST,
    &PATH_SHADE,
    &PATH_SHADE_BY_OCTREE,
    &PATH_SHADE_BY_RECORDS,
    &PATH_TURN,
    &PATH_HAND_OVER,
    &PATH_OCCLUDED,
    &SHADOWS_ASK,
    &SHADOWS_TURN,
    &GATHER_BEGIN,
    &GATHER_SHADE,
    &GATHER_SHADE_BY_OCTREE,
    &GATHER_OCCLUDED,
    &PHOTONS_BEGIN,
    &PHOTONS_FLY,
    &IRRADIANCE_SEEN,
    &IRRADIANCE_RESOLVE,
    &IRRADIANCE_REACH,
    &IRRADIANCE_SPLAT_TILES,
    &OCTREE_SEARCH,
    &OCTREE_WITHIN,
    &CAUSTICS_PLACE,
    &CAUSTICS_SUM_ROWS,
    &CAUSTICS_CHOOSE,
    &CAUSTICS_ALLOT,
    &CAUSTICS_FILL,
    &CAUSTICS_ORDER,
];

/// Everything that is drawn by rasterisation; a test parses and validates each.
pub static RASTERS: &[&Raster] = &[&PLANES, &IRRADIANCE_SPLAT, &SHADOW_MAP];

/// Constants with which the steps are proved: every name that a part expects to be prepended.
pub static PROOF_CONSTANTS: &[(&str, Constant)] = &[
    ("STACK_SIZE", Constant::U32(32)),
    ("HAS_MASKS", Constant::Bool(true)),
    ("HAS_TEXTURES", Constant::Bool(true)),
    ("HAS_GLASS", Constant::Bool(true)),
    ("HAS_GLTF", Constant::Bool(true)),
    ("HAS_SKY_PICTURE", Constant::Bool(true)),
    ("HAS_SECONDARY", Constant::Bool(true)),
    ("HAS_FOCUSED", Constant::Bool(true)),
    ("BROAD_ALPHA", Constant::F32(0.1)),
    ("LOOKS_PAST", Constant::Bool(true)),
    ("NEAR_BLURS", Constant::F32(2.0)),
    ("NEAR_MAX", Constant::U32(3)),
    ("SHADOWS_KNOWN", Constant::Bool(true)),
    ("FROM_DIMENSION", Constant::U32(1 << 14)),
    ("WORKGROUP", Constant::U32(64)),
    ("SHADOW_COS_LEAST", Constant::F32(0.1)),
    ("SHADOW_TEXEL_SMOOTH", Constant::F32(2.0)),
    ("SHADOW_TEXEL_MOST", Constant::F32(8.0)),
    ("SHADOW_ROOM_TEXELS", Constant::F32(0.5)),
    ("SHADOW_SURE", Constant::F32(1e-5)),
    ("SMOOTH_ALPHA", Constant::F32(1e-3)),
    ("FLOAT_MAX", Constant::F32(f32::MAX)),
    ("GAMMA_5", Constant::F32(3e-7)),
    ("GAMMA_19", Constant::F32(1.1e-6)),
    ("TEXTURE_IS_THERE", Constant::U32(1)),
    ("TEXTURE_SECOND_SET", Constant::U32(2)),
    ("TEXTURE_NEAREST", Constant::U32(4)),
    ("TEXTURE_FLOATS", Constant::U32(8)),
    ("TEXTURE_SRGB", Constant::U32(16)),
    ("TEXTURE_WRAP_U_SHIFT", Constant::U32(8)),
    ("TEXTURE_WRAP_V_SHIFT", Constant::U32(10)),
    ("BOUNCES_END", Constant::U32(4096)),
    ("ROULETTE_FREE_BOUNCES", Constant::U32(2)),
    ("SURVIVAL_MAX", Constant::F32(0.998)),
    ("POINT_ROOM", Constant::F32(3e-5)),
    ("LIKE_COS", Constant::F32(0.3)),
    ("PHOTON_SURVIVAL_MAX", Constant::F32(0.99)),
    ("STRAIGHT_COS", Constant::F32(0.999_99)),
    ("BENT_MAX", Constant::F32(8.0)),
    ("TILE_SIDE", Constant::U32(16)),
    ("RADIANCE_MAX", Constant::F32(1e9)),
    ("TONE_REINHARD", Constant::U32(1)),
    ("TONE_ACES", Constant::U32(2)),
    ("TONE_AGX", Constant::U32(3)),
    ("ALBEDO_LEAST", Constant::F32(0.01)),
    ("DEPTH_APART", Constant::F32(0.02)),
    ("DEVIATIONS", Constant::F32(2.25)),
    ("PER_NORMAL", Constant::F32(25.0)),
    ("PER_ALBEDO", Constant::F32(100.0)),
    ("SLOPE", Constant::F32(1.5)),
    ("DIFFERENCE_RED", Constant::F32(0.2126)),
    ("DIFFERENCE_GREEN", Constant::F32(0.7152)),
    ("DIFFERENCE_BLUE", Constant::F32(0.0722)),
    ("WITHOUT_BOUND", Constant::F32(1e30)),
    ("PER_APART", Constant::F32(0.125)),
    ("OWN_WEIGHT", Constant::F32(0.25)),
    ("SIDE_WEIGHT", Constant::F32(0.125)),
    ("CORNER_WEIGHT", Constant::F32(0.0625)),
    ("NORMAL_PLANE", Constant::U32(0)),
    ("ALBEDO_PLANE", Constant::U32(3)),
    ("DEPTH_PLANE", Constant::U32(6)),
    ("PER_DEPTH_PLANE", Constant::U32(7)),
    ("SLOPE_PLANE", Constant::U32(8)),
    ("SURFACE_PLANES", Constant::U32(10)),
    ("LIGHT_PLANES", Constant::U32(4)),
    ("MARGIN", Constant::U32(8)),
    ("SURFACE_MAX", Constant::F32(1e30)),
    ("LIGHT_MAX", Constant::F32(1e7)),
    ("VARIANCE_MAX", Constant::F32(1e16)),
    ("GATHER_FLATNESS", Constant::F32(2.5)),
    ("GATHER_FACING_COS", Constant::F32(0.5)),
    ("GATHER_ALIKE_COS", Constant::F32(0.79)),
    ("GATHER_ANY_COS", Constant::F32(-2.0)),
    ("GATHER_AMPLE", Constant::F32(1.25)),
    ("GATHER_GROWTH_MIN", Constant::F32(1.1)),
    ("GATHER_GROWTH_MAX", Constant::F32(4.0)),
    ("GATHER_GROWTH_BLIND", Constant::F32(2.0)),
    ("GATHER_SMALL", Constant::F32(0.1)),
    ("GATHER_FACING_MIN", Constant::U32(8)),
    ("GATHER_TELLING", Constant::U32(8)),
    ("WALLS_MAX", Constant::U32(6)),
    ("WORK_MAX", Constant::U32(1 << 17)),
    ("GROWTHS_MAX", Constant::U32(128)),
    ("FAR_M", Constant::F32(1e15)),
];

/// A file of WGSL, of which steps are made.
#[derive(Debug)]
pub struct Part {
    /// Room and file, such as `accel/tree`.
    pub name: &'static str,
    /// The text.
    pub source: &'static str,
}

/// A compute shader: what one dispatch runs.
#[derive(Debug)]
pub struct Step {
    /// Room and step, such as `accel/closest`; no two steps share one.
    pub name: &'static str,
    /// The function that runs.
    pub entry_point: &'static str,
    /// What its source is made of, in this order.
    pub parts: &'static [&'static Part],
    /// Invocations of a workgroup along x, y, z, as the entry point says it too (a test compares them).
    pub workgroup_size: [u32; 3],
}

impl Step {
    /// The whole source: `constants`, then the parts.
    ///
    /// - `constants`: `[n]`, names and values, each name once
    pub fn source(&self, constants: &[(&str, Constant)]) -> String {
        source_of(self.parts, constants)
    }
}

/// A vertex and a fragment shader: what one draw runs.
#[derive(Debug)]
pub struct Raster {
    /// Room and what is drawn, such as `path/planes`; no two share one, nor one with a [`Step`].
    pub name: &'static str,
    /// The function that runs for every vertex.
    pub vertex: &'static str,
    /// The function that runs for every pixel of a triangle.
    pub fragment: &'static str,
    /// What becomes of pixels that several triangles are drawn onto.
    pub overlap: Overlap,
    /// What its source is made of, in this order.
    pub parts: &'static [&'static Part],
}

impl Raster {
    /// As [`Step::source`].
    pub fn source(&self, constants: &[(&str, Constant)]) -> String {
        source_of(self.parts, constants)
    }
}

/// What a pixel shows that several triangles are drawn onto.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Overlap {
    /// Four words of the nearest one.
    Nearest,
    /// Four floats of all of them, added up in the order in which they are drawn.
    Sum,
    /// How near the nearest one is, and nothing else.
    Nearness,
}

fn source_of(parts: &[&Part], constants: &[(&str, Constant)]) -> String {
    let mut source = String::new();
    for (name, value) in constants {
        source.push_str(&value.declaration(name));
    }
    for part in parts {
        source.push_str(part.source);
        source.push('\n');
    }
    source
}

/// A number that is prepended to a step's source.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Constant {
    /// A truth, which the compiler knows: what it excludes costs nothing.
    Bool(bool),
    /// A count or an index.
    U32(u32),
    /// A number with a sign.
    I32(i32),
    /// A finite number: WGSL knows no other constants.
    F32(f32),
}

impl Constant {
    /// `const NAME: type = value;` and a line break.
    pub fn declaration(&self, name: &str) -> String {
        match self {
            Constant::Bool(value) => format!("const {name}: bool = {value};\n"),
            Constant::U32(value) => format!("const {name}: u32 = {value}u;\n"),
            Constant::I32(value) => format!("const {name}: i32 = {value};\n"),
            // The shortest decimal number that reads back as the same bits, which WGSL rounds to nearest as Rust does.
            Constant::F32(value) => format!("const {name}: f32 = {value:?}f;\n"),
        }
    }
}
