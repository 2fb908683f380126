//! Numbers: colours, frames, warps with their pdfs, low-discrepancy points, running statistics.
//!
//! Imports nothing of the engine.

mod float;
mod frame;
pub mod octahedral;
mod rgb;
pub mod sobol;
pub mod statistics;
pub mod warp;

pub use float::{next_float_down, next_float_up};
pub use frame::Frame;
pub use rgb::Rgb;
pub use statistics::RunningStatistics;
