//! Pictures → bytes: EXR, PNG and JPEG files, and the payloads of streamed frames; and EXR files → pictures.
//!
//! Knows the engine's film and nothing of who wants the bytes. `exr.rs`, `jpeg.rs` and `frame.rs` turn pictures into
//! bytes in memory, `file.rs` puts bytes on disk so that a name holds a whole picture or what it held before.

mod exr;
mod file;
mod frame;
mod jpeg;

pub use exr::{DecodeError, EXR_LAYERS, ExrLayer, ExrLayers, PictureFacts, decode_exr, encode_exr};
pub use file::{FileError, write_file};
pub use frame::{EncodeError, png_fast, png_small, rgb_f32_le};
pub use jpeg::{JpegQuality, jpeg};
