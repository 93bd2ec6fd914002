//! The tokio and quinn code of both ends. Rules that need no I/O are in `gnomon_protocol`.
//!
//! | module | what |
//! |---|---|
//! | [`control`] | messages on the control stream, over QUIC or TCP |
//! | [`quic`] | ALPN and the transport settings that both ends use |
//! | [`congestion`] | quinn's adapter for `gnomon_protocol::congestion` |
//! | [`socket`] | UDP sockets with large kernel buffers |
//! | [`baseline`] | the dissertation's plain UDP and TCP transports |

pub mod baseline;
pub mod congestion;
pub mod control;
mod error;
pub mod quic;
pub mod socket;

pub use error::root_cause;
