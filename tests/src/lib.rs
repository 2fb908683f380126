//! Whole-system tests, laws and benches.
//!
//! What they share: where to find scenes that are not part of the repository and the built programs, a real server
//! in a process of its own, and blocking clients for its HTTP and its WebSocket. Nothing here sleeps: whoever waits
//! reads with a deadline.

mod http;
mod pictures;
mod programs;
mod random;
mod server;
mod statistics;
mod viewer;

pub use http::Response;
pub use pictures::{Compared, compare_layers, mean, picture};
pub use programs::{program, shared_folder};
pub use random::Random;
pub use server::Server;
pub use statistics::percentile;
pub use viewer::{Event, Viewer};

use std::time::Duration;

/// How long to wait for one thing to happen. Generous: machines of continuous integration have 2 cores, run debug
/// builds and do other things too; whoever waits as long has found a hang, not slowness.
pub const PATIENCE: Duration = Duration::from_secs(60);
