//! Effects: what a scene holds, and which parts of light transport that calls for, with the reason for each.
//!
//! A pure function of the scene, recomputed on every edit. An effect is off only when it provably cannot
//! show: the plan changes what is computed, never the picture. What counts is what is placed: materials and
//! meshes that no node shows decide nothing.
//! Imports `scene`, and from `transport` the roughness below which a surface is a mirror.

mod facts;
mod plan;
#[cfg(test)]
mod tests;

pub use facts::SceneFacts;
pub use plan::{Effect, EffectKind, EffectPlan};
