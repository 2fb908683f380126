//! The thin viewer: a window onto a scene that a Lumicast server keeps lit.
//!
//! It imports the protocol and nothing else of Lumicast; it never sees the engine. Pure: `camera`, `model`, `picture`,
//! `tone_map`, `address`. Sockets: `net`. Widgets: `app`, `viewport`, `panels`, `theme`. All of it also builds for
//! wasm32: `main.rs` starts the same app in a canvas.

pub mod address;
pub mod app;
pub mod camera;
pub mod model;
pub mod net;
pub mod panels;
pub mod picture;
pub mod screenshot;
pub mod theme;
pub mod tone_map;
pub mod viewport;
