//! Gnomon's edge server: ray-traces visibility for many thin clients and streams it to them.
//!
//! A pose's way: `net` receives it → `session` keeps the newest → [`visibility`] traces it → `session` encodes
//! and sends. [`Server::start`] boots the daemon inside any tokio runtime; the binary adds flags, logs and signals.

mod admin;
#[cfg(feature = "agones")]
mod agones;
pub mod cli;
pub mod clock;
pub mod config;
pub mod error;
mod files;
#[doc(hidden)]
pub mod fuzzing;
mod http;
pub mod limits;
mod metrics;
mod net;
mod server;
mod session;
pub mod shutdown;
pub mod telemetry;
pub mod tokens;
pub mod visibility;

pub use server::{RunningServer, Server};
