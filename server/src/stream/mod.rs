//! One viewer's WebSocket: what it says goes to the scene, the newest picture goes to it.
//!
//! Two halves on one socket. The reader takes messages, checks them against limits and rates and calls the scene, none
//! of which blocks. The writer sends answers in order and, between them, the newest picture once there is room in
//! flight. A client that does not read makes the writer wait, and then the reader (answers are a bounded queue), and
//! then TCP; the scene and everybody else go on.

mod rate;
mod session;

pub use session::Session;
