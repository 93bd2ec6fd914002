//! How a session ends.

use tokio::task::JoinError;

use super::driver::DriveError;
use crate::{metrics::causes::EndCause, net::link::CloseCode};

#[derive(Debug)]
pub(super) enum End {
    /// The client said Bye, or ended its stream.
    Left,
    Stopping,
    Lost(String),
    Violation(String),
    Failed(String),
}

impl End {
    pub(super) fn of_stream(ended: Result<Result<(), DriveError>, JoinError>) -> Self {
        match ended {
            // Frames end without an error only if the server stops.
            Ok(Ok(())) => Self::Stopping,
            Ok(Err(DriveError::Link(error))) => Self::Lost(error.to_string()),
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
        }
    }

    pub(super) const fn cause(&self) -> EndCause {
        match self {
            Self::Left => EndCause::Left,
            Self::Stopping => EndCause::Stopping,
            Self::Lost(_) => EndCause::Lost,
            Self::Violation(_) => EndCause::Violation,
            Self::Failed(_) => EndCause::Failed,
        }
    }

    pub(super) fn reason(&self) -> &str {
        match self {
            Self::Left => "the client left",
            Self::Stopping => "the server stops",
            Self::Lost(reason) | Self::Violation(reason) | Self::Failed(reason) => reason,
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
        assert!(matches!(&end, End::Failed(reason) if !reason.contains("secrets")), "{end:?}");
    }
}
