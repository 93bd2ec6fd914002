//! What crosses Gnomon's wire.
//!
//! Sans-IO: bytes and time come in as arguments, nothing here owns a socket, a clock or a GPU.
//! One frame's way through this crate: [`mask`] → [`codec`] → [`frame`] → [`packetizer`] → (the network)
//! → [`reassembler`] → [`frame`] → [`codec`] → [`mask`].

pub mod acknowledgement;
pub mod codec;
pub mod congestion;
pub mod coverage;
pub mod fec;
pub mod frame;
#[doc(hidden)]
pub mod fuzzing;
pub mod header;
pub mod ids;
pub mod limits;
pub mod loss;
pub mod mask;
pub mod message;
pub mod packetizer;
pub mod pose;
pub mod reassembler;
pub mod references;
pub mod refresh;

/// Version of everything in this crate that a peer can see. Peers with different versions refuse each other.
pub const PROTOCOL_VERSION: u16 = 6;
