//! The admin address: `GET /live`, `/ready`, `/metrics` (Prometheus text) and `/sessions` (JSON).
//!
//! It listens apart from the clients' port, on loopback by default, and from the start: a server that still loads its
//! scene is alive and not ready.

mod answer;
mod listener;

pub(crate) use self::listener::Admin;
pub use self::listener::AdminError;
