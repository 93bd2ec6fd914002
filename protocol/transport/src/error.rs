//! Causes of errors.

use std::{error::Error, io};

use gnomon_protocol::text::Escaped;

/// Returns the text of the innermost cause: quinn's errors only say "connection lost". It is escaped, because a closed
/// connection's error repeats what the peer wrote.
#[must_use]
pub fn root_cause(error: &(dyn Error + 'static)) -> String {
    let mut cause = error;
    loop {
        // An `io::Error` skips the error that it wraps when asked for its source.
        let wrapped = cause.downcast_ref::<io::Error>().and_then(io::Error::get_ref);
        match wrapped.map(|wrapped| wrapped as &(dyn Error + 'static)).or_else(|| cause.source()) {
            Some(deeper) => cause = deeper,
            None => return Escaped(cause).to_string(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::ControlError;

    #[test]
    fn the_innermost_cause_is_found_through_io_errors() {
        let lost = io::Error::other(quinn::ReadError::ConnectionLost(quinn::ConnectionError::TimedOut));
        assert_eq!(root_cause(&lost), "timed out");
        assert_eq!(root_cause(&io::Error::from(io::ErrorKind::ConnectionReset)), "connection reset");
        assert_eq!(root_cause(&ControlError::Stream(lost)), "timed out");
    }

    #[test]
    fn a_peers_reason_is_escaped() {
        let reason = bytes::Bytes::from_static(b"bye\x1b[2J\nWARN forged");
        let close = quinn::ApplicationClose { error_code: 0_u32.into(), reason };
        let lost = io::Error::other(quinn::ConnectionError::ApplicationClosed(close));
        for shown in [root_cause(&lost), ControlError::Stream(lost).to_string()] {
            assert!(shown.contains("bye\\u{1b}[2J\\nWARN forged") && !shown.contains(char::is_control), "{shown}");
        }
    }
}
