//! The server as its users meet it: real sockets, port 0, no sleeps; every wait has a deadline.

#![allow(clippy::unwrap_used, reason = "a test that meets what it does not expect has failed")]

mod durable;
mod edits;
mod gpu;
mod harness;
mod hostile;
mod http;
mod openapi;
mod records;
mod schema;
mod stream;
