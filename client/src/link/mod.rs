//! The network: connects, says Hello, fetches the scene; then sends poses and receives masks.

pub mod alternative;
mod backoff;
mod baseline;
pub mod cache_folder;
pub(crate) mod certificate;
mod connection;
mod control_task;
mod health;
pub mod mask_buffer;
mod mask_files;
pub(crate) mod pending_session;
mod quic;
pub(crate) mod receive;
pub mod receive_options;
pub(crate) mod reconnect;
mod resolve;
pub mod scene_cache;
mod send;
pub(crate) mod server_link;
pub(crate) mod session;
pub(crate) mod session_spec;
pub mod state;
pub mod url;
