//! The graphics card: adapter, device, buffers with byte bounds, pipelines, batches of work, reading back, loss.
//!
//! Imports `accel` for the packed trees and `film` for pictures that are shown and noise that is taken off them; wgpu is named only here and in the rooms' `gpu.rs`. Shaders come from the crate
//! `lumicast-shaders`. Why [`Gpu`] and [`Session`] are two: a device can be lost at any time (driver update, watchdog,
//! a card that is pulled), and all its buffers with it. A `Session` is one device and lives until then; [`Gpu::session`]
//! opens the next. Whoever holds buffers compares [`Session::generation`] and uploads again.
//!
//! Nothing here panics on what a card or its driver does: every call says [`GpuError`], and the CPU computes the same.

mod adapter;
mod batch;
mod buffer;
mod denoise;
mod error;
mod frame;
mod pipeline;
mod raster;
mod read_back;
mod session;
mod show;
mod staging;
#[cfg(test)]
pub(crate) mod tests;
mod trees;

pub use adapter::{AdapterChoice, AdapterKind, AdapterReason, AdapterReport};
pub(crate) use batch::Begin;
pub use batch::{Batch, Submission};
pub use buffer::{BindGroup, Binding, Buffer, Layout};
pub use denoise::{DenoiseOnCard, DenoisedOnCard};
pub use error::GpuError;
pub(crate) use frame::{FRAME_SAMPLE_BYTES, FrameOnCard, FrameShown};
pub use lumicast_shaders::{Constant, Overlap, Part, Raster, Step};
pub use pipeline::Pipeline;
pub use raster::{Draw, Quads, RasterPipeline, SumsBegin, Target};
pub use read_back::ReadBack;
pub(crate) use session::locked;
pub use session::{Gpu, GpuOptions, Session};
pub use show::{ShowOnCard, ShownOnCard};
pub use trees::{GpuHit, GpuRay, GpuShadowRay, GpuTrees, Masks};
