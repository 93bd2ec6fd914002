//! Gnomon's edge server: ray-traces visibility for many thin clients and streams it to them.
//!
//! Path of a pose: `net` receives it → `session` keeps the newest → [`visibility`] traces it → `session` encodes and
//! sends. [`Server::start`] boots the daemon inside any tokio runtime; the binary adds flags, logs and signals.

mod admission;
mod app;
pub mod cli;
pub mod clock;
pub mod config;
mod files;
#[doc(hidden)]
pub mod fuzzing;
mod hex;
pub mod limits;
mod metrics;
mod names;
mod net;
mod operate;
mod origins;
mod phase;
mod session;
mod task;
pub mod visibility;
mod web;
mod world;

pub use admission::tokens;
pub use app::{error, running::RunningServer, signals, start::Server};
pub use net::certificate::commands as certificate;
pub use operate::{admin::hosts, logs, otlp, sessions_command, systemd};
