//! How a session ends.

use std::borrow::Cow;

use gnomon_protocol::text::Escaped;
use tokio::task::JoinError;

use super::driver::DriveError;
use crate::{admission::end_reason::EndReason, metrics::causes::EndCause, net::link::CloseCode};

#[derive(Debug)]
pub(super) enum End {
    /// The client said Bye, or ended its stream.
    Left,
    Stopping,
    Lost(String),
    Violation(String),
    Failed(String),
    /// From outside, for a reason that the client is told.
    Ended(EndReason),
}

impl End {
    pub(super) fn by(reason: EndReason) -> Self {
        match reason {
            EndReason::Superseded => Self::Lost(reason.to_string()),
            reason => Self::Ended(reason),
        }
    }

    pub(super) fn of_stream(ended: Result<Result<(), DriveError>, JoinError>) -> Self {
        match ended {
            // Frames end without an error only if the server stops.
            Ok(Ok(())) => Self::Stopping,
            Ok(Err(DriveError::Link(error))) => Self::Lost(Escaped(error).to_string()),
            Ok(Err(error)) => Self::Failed(error.to_string()),
            Err(panic) => {
                tracing::error!(%panic, "a task of the session panicked");
                Self::Failed("the server failed in this session".to_owned())
            }
        }
    }

    pub(super) const fn code(&self) -> CloseCode {
        match self {
            Self::Left | Self::Stopping | Self::Lost(_) => CloseCode::Done,
            Self::Violation(_) => CloseCode::Violation,
            Self::Failed(_) => CloseCode::Internal,
            Self::Ended(_) => CloseCode::Ended,
        }
    }

    /// Whether the client may come back by itself.
    pub(super) const fn may_return(&self) -> bool {
        !matches!(self, Self::Ended(_))
    }

    pub(super) const fn cause(&self) -> EndCause {
        match self {
            Self::Left => EndCause::Left,
            Self::Stopping => EndCause::Stopping,
            Self::Lost(_) => EndCause::Lost,
            Self::Violation(_) => EndCause::Violation,
            Self::Failed(_) => EndCause::Failed,
            Self::Ended(EndReason::TokenWithdrawn | EndReason::TokenExpired) => EndCause::Token,
            Self::Ended(EndReason::Operator | EndReason::Superseded) => EndCause::Operator,
        }
    }

    pub(super) fn reason(&self) -> Cow<'_, str> {
        match self {
            Self::Left => "the client left".into(),
            Self::Stopping => "the server stops".into(),
            Self::Lost(reason) | Self::Violation(reason) | Self::Failed(reason) => reason.into(),
            Self::Ended(reason) => reason.to_string().into(),
        }
    }
}

#[cfg(test)]
mod tests {
    use tokio::task::JoinSet;

    use super::*;

    #[tokio::test]
    async fn a_panic_ends_its_session_without_telling_the_client() {
        let mut stream: JoinSet<Result<(), DriveError>> = JoinSet::new();
        stream.spawn(async { panic!("inner secrets") });
        let end = End::of_stream(stream.join_next().await.unwrap());
        assert_eq!(end.code(), CloseCode::Internal);
        assert!(end.may_return());
        assert!(matches!(&end, End::Failed(reason) if !reason.contains("secrets")), "{end:?}");
    }
}
