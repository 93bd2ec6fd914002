//! The client's side of the network: connect, introduce itself, fetch the scene, then poses out and masks in.

mod congestion;
pub(crate) mod control;
mod lab;
pub(crate) mod link;
mod quic;
pub(crate) mod receive;
mod send;
pub(crate) mod session;
pub mod url;
