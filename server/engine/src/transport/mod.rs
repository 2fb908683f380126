//! Light transport: how surfaces scatter, how lights are sampled, and which room a path belongs to.
//!
//! [`World`] is the scene made ready for paths: trees, materials with their textures, lights. Techniques ask it for
//! hits, surfaces and light samples and know nothing of how they are stored.
//!
//! Imports `math`, `scene` and `accel`.

pub mod bsdf;
mod flight;
mod light;
mod panes;
mod path_class;
mod surface;
mod upload;
mod world;

pub use bsdf::{Bsdf, BsdfSample, BsdfValue, CoatedBase, EVEN_RISE, schlick_rise};
pub use flight::Flight;
#[cfg(feature = "gpu")]
pub(crate) use flight::{BENT_MAX, STRAIGHT_COS};
#[cfg(feature = "gpu")]
pub(crate) use light::POINT_ROOM;
pub use light::{
    Aim, AimedPhoton, EmissionNumbers, EmittedPhoton, LightOrigin, LightSample, Lights, Opening, Source,
    SourceName, Sphere, Through,
};
#[cfg(all(test, feature = "gpu"))]
pub(crate) use light::{FEW, IMPORTANCE_MAX, LEVEL};
pub(crate) use light::{LightsChange, change_of_lights};
pub use panes::{Passage, Passed};
pub use path_class::{PathClass, PathClasses, Scatter};
pub use surface::{Absorption, Normals, Surface};
pub use upload::{
    AppearanceBuffers, GpuLight, GpuLightNode, GpuMaterial, GpuPlacement, GpuSceneHeader, GpuTextureUse,
    TEXTURE_FLAGS, WorldBuffers, WorldFeatures,
};
pub use world::{ShadowRay, World, WorldReport};
