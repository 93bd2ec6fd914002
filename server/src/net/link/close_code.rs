//! Application error codes of closed connections.

use quinn::VarInt;

/// A WebTransport session closes with the same codes as a native connection.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub(crate) enum CloseCode {
    Done = 0,
    Refused = 1,
    Violation = 2,
    Internal = 3,
    /// The session was ended by the operator, or with its token.
    Ended = 4,
}

impl CloseCode {
    /// The WebSocket's code (RFC 6455 §7.4), from the range for private use.
    pub(crate) const fn websocket(self) -> u16 {
        4000 + self as u16
    }

    /// The HTTP/3 code (RFC 9114 §8.1) for a connection that has no WebTransport session.
    pub(crate) const fn http3(self) -> VarInt {
        VarInt::from_u32(match self {
            Self::Done => 0x100,
            Self::Refused | Self::Ended => 0x10b,
            Self::Violation => 0x101,
            Self::Internal => 0x102,
        })
    }
}
