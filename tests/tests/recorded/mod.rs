//! What the recorded run is made of: edits from a seed, and viewers that write down what they see.

pub(crate) mod edits;
pub(crate) mod watcher;
