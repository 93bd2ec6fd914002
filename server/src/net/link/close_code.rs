//! Application error codes of closed connections.

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub(crate) enum CloseCode {
    Done = 0,
    /// The client was not admitted.
    Refused = 1,
    /// The client broke the protocol.
    Violation = 2,
    /// The server failed.
    Internal = 3,
}
