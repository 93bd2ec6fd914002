//! The program: starts a server, accepts peers, and shuts down.

mod accept;
pub mod error;
pub(crate) mod running;
mod scene;
pub mod signals;
pub(crate) mod start;
mod url;
mod warm_up;
