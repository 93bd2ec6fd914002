//! The program: starts a server, stops it, and says why it could not start.

pub mod error;
pub(crate) mod server;
pub mod signals;
