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
        /// Time of the next attempt; `None` if there is none, for example because the server has another certificate.
        retry_at: Option<Instant>,
    },
    /// The server has another scene, which is being fetched. In bytes; both are 0 before the first.
    Fetching { have: u64, length: u64 },
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
            Self::Fetching { .. } => "fetching",
        }
    }

    /// Returns whether masks can arrive.
    #[must_use]
    pub const fn is_served(&self) -> bool {
        matches!(self, Self::Live | Self::Draining { .. })
    }

    /// Returns why a run that ends in this state ends without its server; `None` if it does not.
    #[must_use]
    pub fn loss(&self) -> Option<String> {
        match self {
            Self::Live | Self::Draining { .. } | Self::Connecting => None,
            Self::Refused { reason, .. } | Self::Lost { reason, .. } => Some(reason.clone()),
            Self::Fetching { .. } => Some("the server has another scene, which had not arrived yet".to_owned()),
        }
    }

    /// Returns whether the client has given up.
    #[must_use]
    pub const fn is_final(&self) -> bool {
        matches!(self, Self::Refused { retry_at: None, .. } | Self::Lost { retry_at: None, .. })
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
            Self::Fetching { have, length } => {
                let mib = |bytes: &u64| *bytes as f64 / f64::from(1 << 20);
                format!("The server has another scene: {:.1} of {:.1} MiB", mib(have), mib(length))
            }
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
                LinkState::Fetching { have: 1 << 20, length: 4 << 20 },
                Some("The server has another scene: 1.0 of 4.0 MiB"),
            ),
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

    #[test]
    fn a_run_that_ends_without_its_server_can_say_why() {
        let reason = || "it is full".to_owned();
        let later = Some(Instant::now());
        for (state, loss, is_final) in [
            (LinkState::Live, false, false),
            (
                LinkState::Draining { reason: reason().into(), deadline: Instant::now(), alternative: None },
                false,
                false,
            ),
            (LinkState::Refused { reason: reason(), retry_at: later }, true, false),
            (LinkState::Refused { reason: reason(), retry_at: None }, true, true),
            (LinkState::Lost { reason: reason(), retry_at: later }, true, false),
            (LinkState::Lost { reason: reason(), retry_at: None }, true, true),
            (LinkState::Fetching { have: 0, length: 0 }, true, false),
        ] {
            assert_eq!((state.loss().is_some(), state.is_final()), (loss, is_final), "{state:?}");
        }
    }
}
