//! Completes WebTransport's handshake with a page that may connect.

use std::time::Duration;

use gnomon_protocol::text::{Escaped, PeerText};
use thiserror::Error;
use tokio::time::timeout;
use web_transport_quinn::{Request, ServerError, Session, http::StatusCode};

use crate::origins::Origins;

/// Most of an origin that an error quotes.
const QUOTED_BYTES: usize = 100;

#[derive(Debug, Error)]
pub(crate) enum PageError {
    #[error("WebTransport handshake: {}", Escaped(.0))]
    Handshake(#[from] ServerError),
    #[error("--origins does not list the page's origin {0:?}")]
    Origin(PeerText),
}

/// Without a list every origin may connect. Errors if the origin is not listed, after the page was told with status 403
/// and has had `linger` to read it.
pub(super) async fn admit(
    connection: quinn::Connection,
    origins: Option<&Origins>,
    linger: Duration,
) -> Result<Session, PageError> {
    let request = Request::accept(connection.clone()).await?;
    let origin = request.headers.get("origin").map_or(&b""[..], |origin| origin.as_bytes());
    if origins.is_none_or(|origins| origins.allow(origin)) {
        return Ok(request.ok().await?);
    }
    let quoted = PeerText::from_bytes(&origin[..origin.len().min(QUOTED_BYTES)]);
    request.reject(StatusCode::FORBIDDEN).await?;
    // Closing at once would overtake the answer.
    let _ = timeout(linger, connection.closed()).await;
    Err(PageError::Origin(quoted))
}
