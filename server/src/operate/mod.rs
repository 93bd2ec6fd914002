//! Operators' interfaces: the admin address, readiness, logs, OTLP reports, systemd, Agones.

pub(crate) mod admin;
#[cfg(feature = "agones")]
pub(crate) mod agones;
mod http;
pub mod logs;
pub mod otlp;
pub(crate) mod readiness;
pub mod sessions_command;
pub(crate) mod status;
pub mod systemd;
