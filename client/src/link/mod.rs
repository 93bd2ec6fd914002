//! The network: connect, say Hello, fetch the scene; then poses out and masks in.

mod backoff;
mod baseline;
pub(crate) mod certificate;
pub(crate) mod connection;
pub(crate) mod health;
pub mod mask_buffer;
mod mask_files;
mod quic;
pub(crate) mod receive;
pub mod receive_options;
pub(crate) mod reconnect;
mod resolve;
pub mod scene_cache;
mod send;
pub(crate) mod server_link;
pub(crate) mod session;
pub mod state;
pub mod url;
