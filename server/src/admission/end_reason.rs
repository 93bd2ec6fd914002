//! Why a session is ended from outside, in words for its client.

use std::fmt;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum EndReason {
    /// Its client resumed it on another connection.
    Superseded,
    /// An operator ended it. Its client may not resume it, and is asked to stay away for a while
    /// ([`crate::limits::DISMISSED_FOR`]).
    Operator,
    TokenWithdrawn,
    TokenExpired,
}

impl fmt::Display for EndReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Superseded => "the client resumed on another connection",
            Self::Operator => "the operator ended this session",
            Self::TokenWithdrawn => "its token was withdrawn",
            Self::TokenExpired => "its token expired",
        })
    }
}
