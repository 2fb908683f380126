//! Effects: what a scene holds, and which parts of light transport that calls for, with the reason for each.
//!
//! A pure function of the scene, brought up to date at every edit by what the edit touched ([`Inventory`]). An effect is off
//! only when it provably cannot show: the plan changes what is computed, never the picture. What counts is what is placed:
//! materials and meshes that no node shows decide nothing. Those who look may [choose](EffectChoices) otherwise.
//! Imports `scene`, and from `transport` the roughness below which a surface is a mirror and the classes of paths.

mod choice;
mod facts;
mod inventory;
mod plan;
#[cfg(test)]
mod tests;

pub use choice::{EffectChoice, EffectChoices};
pub use facts::SceneFacts;
pub use inventory::Inventory;
pub use plan::{Effect, EffectKind, EffectPlan};
