//! Causes of errors.

use std::{error::Error, io};

/// Returns the text of the innermost cause: quinn's errors only say "connection lost".
#[must_use]
pub fn root_cause(error: &(dyn Error + 'static)) -> String {
    let mut cause = error;
    loop {
        // An `io::Error` skips the error that it wraps when asked for its source.
        let wrapped = cause.downcast_ref::<io::Error>().and_then(io::Error::get_ref);
        match wrapped.map(|wrapped| wrapped as &(dyn Error + 'static)).or_else(|| cause.source()) {
            Some(deeper) => cause = deeper,
            None => return cause.to_string(),
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
}
