//! The server as its users meet it: real sockets, port 0, no sleeps; every wait has a deadline.

mod durable;
mod edits;
mod harness;
mod hostile;
mod http;
mod openapi;
mod schema;
mod stream;
