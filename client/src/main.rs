//! `lumicast-viewer`.
fn main() {}
