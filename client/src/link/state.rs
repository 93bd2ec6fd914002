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

    /// Returns what a person should know about the link; `None` while all is well.
    #[must_use]
    pub fn message(&self, now: Instant) -> Option<String> {
        let seconds = |at: Instant| at.saturating_duration_since(now).as_secs_f64().ceil();
        let again = |at: &Option<Instant>| match at {
            Some(at) if seconds(*at) >= 1.0 => format!("Trying again in {} s", seconds(*at)),
            Some(_) => "Trying again".to_owned(),
            None => "Not trying again".to_owned(),
        };
        Some(match self {
            Self::Live => return None,
            Self::Connecting => "Looking for the server".to_owned(),
            Self::Refused { reason, retry_at } => format!("Refused: {reason}. {}", again(retry_at)),
            Self::Lost { reason, retry_at } => format!("Server lost: {reason}. {}", again(retry_at)),
            Self::Draining { reason, deadline, alternative } => {
                let elsewhere = alternative.as_ref().map_or(String::new(), |url| {
                    // Its certificate would make the line unreadable.
                    format!(". Going on at {}", url.split('?').next().unwrap_or_default())
                });
                format!("The server stops in {} s: {reason}{elsewhere}", seconds(*deadline))
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn reasons_and_times_are_said() {
        let now = Instant::now();
        let soon = now + Duration::from_millis(2500);
        let reason = || "it is full".to_owned();
        for (state, said) in [
            (LinkState::Live, None),
            (LinkState::Refused { reason: reason(), retry_at: None }, Some("Refused: it is full. Not trying again")),
            (
                LinkState::Refused { reason: reason(), retry_at: Some(soon) },
                Some("Refused: it is full. Trying again in 3 s"),
            ),
            (LinkState::Lost { reason: reason(), retry_at: Some(now) }, Some("Server lost: it is full. Trying again")),
            (
                LinkState::Draining {
                    reason: reason(),
                    deadline: soon,
                    alternative: Some("gnomon://b:1/?cert=00".to_owned()),
                },
                Some("The server stops in 3 s: it is full. Going on at gnomon://b:1/"),
            ),
        ] {
            assert_eq!(state.message(now).as_deref(), said, "{state:?}");
        }
    }
}
