//! The server: files, HTTP, WebSocket, sessions, store and command line around the engine.
//!
//! A camera's way to a picture: `stream → scenes → engine::render → engine::film → images → socket`.
//! The binary `lumicast` only reads arguments and calls [`cli`].

#![allow(
    clippy::result_large_err,
    reason = "a problem is made once per refused request; boxing it everywhere would cost more words than it saves bytes"
)]

pub mod assets;
pub mod cli;
pub mod config;
pub mod convert;
mod duration;
mod graphics;
pub mod http;
pub mod images;
pub mod report;
pub mod scenes;
pub mod shutdown;
pub mod store;
pub mod stream;
pub mod telemetry;
