//! The line to the server: a WebSocket and small HTTP requests, natively and in a browser, behind two small traits.
//!
//! Everything is bounded: what has come and was not yet taken (the socket is not read further, which slows the server
//! down), and what is to go (there is room or there is not; the model keeps the newest of each kind until there is).
//! Pictures are decoded here, beside the window's thread where there is one.

#[cfg(not(target_arch = "wasm32"))]
mod native;
#[cfg(not(target_arch = "wasm32"))]
pub use native::Native as Platform;

#[cfg(target_arch = "wasm32")]
mod web;
#[cfg(target_arch = "wasm32")]
pub use web::Web as Platform;

use crate::picture::{self, Decoded, PictureError};
use std::sync::Arc;
use std::sync::mpsc::Receiver;

/// Messages that have come and wait for the window. The server keeps two pictures in flight; the rest is small.
pub const INCOMING_MAX: usize = 32;
/// Messages on their way out. The model holds back what finds no room.
pub const OUTGOING_MAX: usize = 16;
/// Largest message: a float picture of 4096 × 4096, and a scene of a million nodes as JSON, stay below it.
pub const MESSAGE_BYTES_MAX: usize = 256 << 20;
/// Largest answer of an HTTP request: a list of scenes or effects.
pub const ANSWER_BYTES_MAX: u64 = 16 << 20;

/// Called from any thread when something has come.
pub type Wake = Arc<dyn Fn() + Send + Sync>;

/// What the line says.
#[derive(Debug)]
pub enum WireEvent {
    /// The socket is open and speaks our subprotocol.
    Opened,
    /// A text frame.
    Text(String),
    /// A binary frame, decoded.
    Picture {
        /// The picture.
        picture: Box<Result<Decoded, PictureError>>,
        /// The frame number to acknowledge, as far as it could be read.
        frame: Option<u64>,
    },
    /// The last thing a wire says.
    Closed {
        /// Why, in words.
        reason: String,
        /// Whether trying again is useless.
        is_final: bool,
    },
}

impl WireEvent {
    /// A binary frame as it came.
    pub fn from_binary(message: &[u8]) -> Self {
        let picture = picture::decode(message);
        let frame = match &picture {
            Ok(decoded) => Some(decoded.header.frame),
            Err(_) => picture::frame_number(message),
        };
        Self::Picture { picture: Box::new(picture), frame }
    }
}

/// An open or opening socket. Dropping it closes it.
pub trait Wire {
    /// What has come, oldest first.
    fn poll(&mut self) -> Option<WireEvent>;
    /// Whether [`Wire::send`] will take a message.
    fn has_room(&self) -> bool;
    /// Sends a text frame; drops it where there is no room.
    fn send(&mut self, text: String);
}

/// The outside world.
pub trait Network {
    /// Opens a WebSocket with our subprotocol.
    fn open(&self, url: &str, wake: Wake) -> Box<dyn Wire>;
    /// Asks for a small document; the answer's body, or why there is none, comes once.
    fn get(&self, url: &str, wake: Wake) -> Receiver<Result<String, String>>;
}

/// What an HTTP answer other than 2xx says, in words: a problem's detail, or the status alone.
#[cfg_attr(
    target_arch = "wasm32",
    allow(dead_code, reason = "a browser hides the answer to a failed upgrade")
)]
fn refusal(status: u16, body: &[u8]) -> String {
    match serde_json::from_slice::<lumicast_protocol::Problem>(body) {
        Ok(problem) if !problem.detail.is_empty() => format!("{}: {}", problem.title, problem.detail),
        Ok(problem) => problem.title,
        Err(_) => format!("the server answered with status {status}"),
    }
}
