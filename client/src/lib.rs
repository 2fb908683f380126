//! The thin viewer: a window onto a scene that a Lumicast server keeps lit.
//!
//! It imports the protocol and nothing else of Lumicast; it never sees the engine. Pure: `camera`, `model`, `picture`,
//! `tone_map`, `address`. Sockets: `net`. Widgets: `app`, `viewport`, `panels`, `theme`. The pure part and `net` also build for
//! wasm32, and so does the app: `main.rs` starts it in a canvas there.

pub mod address;
pub mod camera;
pub mod model;
pub mod net;
pub mod picture;
pub mod tone_map;
