//! What stands around the picture, a file per panel. Each shows the model and tells it what the person wants; none of
//! them talks to the network.

pub mod accuracy;
pub mod connection;
pub mod effects;
pub mod forecast;
pub mod form;
pub mod help;
pub mod inspector;
pub mod messages;
pub mod numbers;
pub mod plot;
pub mod scene;
pub mod statistics;
pub mod status;
