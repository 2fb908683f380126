//! Light transport: how surfaces scatter, how lights are sampled, and which room a path belongs to.

mod path_class;

pub use path_class::PathClass;
