//! The client's side of the network: connect, introduce itself, fetch the scene, then poses out and masks in.

mod backoff;
mod baseline;
pub(crate) mod first_use;
pub(crate) mod health;
pub(crate) mod link;
pub mod link_state;
mod quic;
pub(crate) mod receive;
pub mod reception;
pub(crate) mod reconnect;
mod send;
pub(crate) mod session;
pub mod url;
