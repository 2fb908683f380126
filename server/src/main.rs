//! `lumicast`.
fn main() {}
