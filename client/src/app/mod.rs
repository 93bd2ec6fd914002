//! Set-up around a run: finding a server and its scene, starting local servers, and watching for signals.

pub(crate) mod connect;
#[cfg(feature = "window")]
pub mod demo;
mod first_visit;
pub mod local_server;
pub(crate) mod look;
pub mod probe;
pub mod servers;
pub mod signals;
