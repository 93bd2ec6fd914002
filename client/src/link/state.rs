//! The state of the link, as windows, logs and recordings show it.

use std::time::Instant;

use gnomon_protocol::text::PeerText;

use super::url::ServerUrl;

/// The state of the link. The client draws in all of them, with received visibility while it has any.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum LinkState {
    /// The server has not answered yet.
    Connecting,
    /// Poses go out and masks come in.
    Live,
    /// The server refuses this client.
    Refused {
        reason: String,
        /// Time of the next attempt; `None` if there is none.
        retry_at: Option<Instant>,
    },
    /// The server still serves, but is about to stop.
    Draining {
        reason: PeerText,
        deadline: Instant,
        /// The server to move to, if any.
        alternative: Option<ServerUrl>,
    },
    /// The connection is lost.
    Lost {
        reason: String,
        /// Time of the next attempt; `None` if there is none, for example because the server now has another scene.
        retry_at: Option<Instant>,
    },
}

impl LinkState {
    /// Name in logs and statistics.
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

    /// Returns whether masks can arrive.
    #[must_use]
    pub const fn is_served(&self) -> bool {
        matches!(self, Self::Live | Self::Draining { .. })
    }

    /// Returns a message for people; `None` while the link is fine.
    #[must_use]
    pub fn message(&self, now: Instant) -> Option<String> {
        let seconds = |at: Instant| at.saturating_duration_since(now).as_secs_f64().ceil();
        let next_try = |at: &Option<Instant>| match at {
            Some(at) if seconds(*at) >= 1.0 => format!("Trying again in {} s", seconds(*at)),
            Some(_) => "Trying again".to_owned(),
            None => "Not trying again".to_owned(),
        };
        Some(match self {
            Self::Live => return None,
            Self::Connecting => "Connecting to the server".to_owned(),
            Self::Refused { reason, retry_at } => format!("Refused: {reason}. {}", next_try(retry_at)),
            Self::Lost { reason, retry_at } => format!("Server lost: {reason}. {}", next_try(retry_at)),
            Self::Draining { reason, deadline, alternative } => {
                let redirect = alternative.as_ref().map(|url| format!(". Continuing at {url}")).unwrap_or_default();
                format!("The server stops in {} s: {reason}{redirect}", seconds(*deadline))
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn messages_name_reasons_and_times() {
        let now = Instant::now();
        let soon = now + Duration::from_millis(2500);
        let reason = || "it is full".to_owned();
        for (state, message) in [
            (LinkState::Live, None),
            (LinkState::Refused { reason: reason(), retry_at: None }, Some("Refused: it is full. Not trying again")),
            (
                LinkState::Refused { reason: reason(), retry_at: Some(soon) },
                Some("Refused: it is full. Trying again in 3 s"),
            ),
            (LinkState::Lost { reason: reason(), retry_at: Some(now) }, Some("Server lost: it is full. Trying again")),
            (
                LinkState::Draining {
                    reason: "it is full\x1b[2J".into(),
                    deadline: soon,
                    alternative: Some(format!("gnomon://b:1/?cert={}", "00".repeat(32)).parse().unwrap()),
                },
                Some("The server stops in 3 s: it is full\\u{1b}[2J. Continuing at gnomon://b:1"),
            ),
        ] {
            assert_eq!(state.message(now).as_deref(), message, "{state:?}");
        }
    }
}
