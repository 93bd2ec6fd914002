//! Trust on first use: pins the certificate that a server shows on the first visit.
//!
//! The visit only fetches the certificate, so that no token reaches a server before it is pinned.

use std::time::Duration;

use super::{
    quic::{self, Trust},
    resolve::first_reachable,
    url::ServerUrl,
};
use crate::error::ClientError;

/// Returns the SHA-256 of the certificate that the server at `url` shows.
///
/// # Errors
/// Errors if the server does not answer within `limit`.
pub(crate) async fn fetch_certificate(url: &ServerUrl, limit: Duration) -> Result<[u8; 32], ClientError> {
    first_reachable(url, limit, |address| async move {
        let (endpoint, connection) =
            quic::connect(address, Trust::FirstUse).await.map_err(|error| error.at_server(url))?;
        let digest = quic::certificate_sha256(&connection);
        connection.close(0_u32.into(), b"only the certificate was needed");
        endpoint.wait_idle().await;
        digest.ok_or_else(|| ClientError::Connect {
            url: Box::new(url.clone()),
            reason: "the server shows no certificate".to_owned(),
        })
    })
    .await
}
