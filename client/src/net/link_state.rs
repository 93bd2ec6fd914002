//! How this client stands with its server, for whoever shows it: a window, a log, a summary.

use std::time::Instant;

/// How the client stands with its server. Whatever it is, the client draws: with received visibility while there is some, and with
/// what it knows by itself otherwise.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum LinkState {
    /// It has not been answered yet.
    Connecting,
    /// Poses go out and masks come in.
    Live,
    /// The server does not admit this client.
    Refused {
        /// Why, in words for people.
        reason: String,
        /// When it is asked again; `None` where asking again is of no use.
        retry_at: Option<Instant>,
    },
    /// The server stops soon, and still serves.
    Draining {
        /// Why.
        reason: String,
        /// When it closes.
        deadline: Instant,
        /// URL of the server to go to, where it named one.
        alternative: Option<String>,
    },
    /// The connection is lost.
    Lost {
        /// Why.
        reason: String,
        /// When the next attempt begins; `None` where there is none, because the server has another scene now, for example.
        retry_at: Option<Instant>,
    },
}

impl LinkState {
    /// One word, for logs and statistics.
    #[must_use]
    pub const fn name(&self) -> &'static str {
        match self {
            Self::Connecting => "connecting",
            Self::Live => "live",
            Self::Refused { .. } => "refused",
            Self::Draining { .. } => "draining",
            Self::Lost { .. } => "lost",
        }
    }

    /// Whether masks can come.
    #[must_use]
    pub const fn is_served(&self) -> bool {
        matches!(self, Self::Live | Self::Draining { .. })
    }
}
