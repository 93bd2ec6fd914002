//! Application error codes of closed connections.

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
