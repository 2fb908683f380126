//! Lumicast's engine: a scene goes in, light comes out.
//!
//! The engine knows nothing of network, async, files or user interfaces, and holds no global state.
//! Its rooms stand in one row and import to the left only:
//! `math ← scene ← accel ← transport ← film ← gpu ← technique ← effects ← render`.
//! `gpu` is there with the cargo feature of that name, which is on by default; shaders are the crate `lumicast-shaders`.
//! Sources are cited by key (`[Veach1997]`); the keys are listed in `SOURCES.md` beside this crate.

// Citations such as [Veach1997] look like links to rustdoc and are none.
#![allow(rustdoc::broken_intra_doc_links)]

pub mod accel;
pub mod effects;
pub mod film;
#[cfg(feature = "gpu")]
pub mod gpu;
pub mod math;
pub mod render;
pub mod scene;
pub mod technique;
pub mod transport;
