//! The admin address: `GET /live`, `/ready`, `/metrics` (Prometheus text) and `/sessions` (JSON), and
//! `POST /sessions/ID/end`.
//!
//! It is separate from the clients' port, on loopback by default, and listens from the start: a server that is still
//! loading its scene is live but not ready.

mod answer;
pub mod hosts;
mod listener;
mod seats;

pub(crate) use self::listener::Admin;
pub use self::listener::AdminError;
