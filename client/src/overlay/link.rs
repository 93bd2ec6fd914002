//! How it stands with the server, in words.

use std::time::Instant;

use crate::net::link_state::LinkState;

/// What a person should know of it; nothing while all is well.
pub(crate) fn in_words(state: &LinkState, now: Instant) -> Option<String> {
    let seconds = |at: Instant| at.saturating_duration_since(now).as_secs_f64().ceil();
    let again = |at: &Option<Instant>| match at {
        Some(at) if seconds(*at) >= 1.0 => format!("Trying again in {} s", seconds(*at)),
        Some(_) => "Trying again".to_owned(),
        None => "Not trying again".to_owned(),
    };
    Some(match state {
        LinkState::Live => return None,
        LinkState::Connecting => "Looking for the server".to_owned(),
        LinkState::Refused { reason, retry_at } => format!("Refused: {reason}. {}", again(retry_at)),
        LinkState::Lost { reason, retry_at } => format!("Server lost: {reason}. {}", again(retry_at)),
        LinkState::Draining { reason, deadline, alternative } => {
            let elsewhere = alternative.as_ref().map_or(String::new(), |url| {
                // Its certificate would make the line unreadable.
                format!(". Going on at {}", url.split('?').next().unwrap_or_default())
            });
            format!("The server stops in {} s: {reason}{elsewhere}", seconds(*deadline))
        }
    })
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
            assert_eq!(in_words(&state, now).as_deref(), said, "{state:?}");
        }
    }
}
