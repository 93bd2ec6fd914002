//! Gnomon's wire protocol.
//!
//! Sans-IO: bytes and time come in as arguments; nothing here owns a socket, a clock or a GPU. The folders follow a
//! frame: [`mask`] → `codec/` → `send/` → `wire/` → (the network) → `receive/` → `codec/` → [`mask`].

pub mod codec;
pub mod coverage;
pub mod fec;
#[doc(hidden)]
pub mod fuzzing;
pub mod ids;
pub mod limits;
pub mod mask;
mod path;
pub mod pose;
pub mod receive;
pub mod references;
mod send;
pub mod text;
mod wire;

pub use self::{
    path::{average, congestion, loss},
    receive::reassembler,
    send::{packetizer, refresh},
    wire::{acknowledgement, edit, frame, header, message},
};

/// Version of everything in this crate that a peer can see. Peers with different versions refuse each other.
pub const PROTOCOL_VERSION: u16 = 7;
