//! The first visit to a server whose certificate nobody has told this client: whatever it shows now is what it has to show from then on.
//!
//! Only the certificate is asked for. Nothing is said to the server before it is pinned, and no token goes to a stranger.

use std::time::Duration;

use tokio::net::lookup_host;

use super::{
    quic::{self, QuicError},
    url::ServerUrl,
};
use crate::error::ClientError;

/// SHA-256 of the certificate that the server at `url` shows, within `patience`.
///
/// # Errors
/// When it cannot be reached.
pub(crate) async fn certificate_of(url: &ServerUrl, patience: Duration) -> Result<[u8; 32], ClientError> {
    let failed = |reason: String| ClientError::Connect { url: Box::new(url.clone()), reason };
    let unreachable = || ClientError::Unreachable { url: Box::new(url.clone()), after: patience };
    let ask = async {
        let found = lookup_host((url.host.as_str(), url.port)).await;
        let found = found.map_err(|error| failed(format!("host {:?}: {error}", url.host)))?;
        let mut last = failed(format!("host {:?} has no address", url.host));
        for address in found {
            match quic::connect(address, quic::Trust::FirstUse).await {
                Ok((endpoint, connection)) => {
                    let digest = quic::certificate_of(&connection);
                    connection.close(0_u32.into(), b"only the certificate was asked for");
                    endpoint.wait_idle().await;
                    return digest.ok_or_else(|| failed("it shows no certificate".to_owned()));
                }
                Err(QuicError::TimedOut) => last = unreachable(),
                Err(QuicError::Certificate) => last = failed("its certificate is no certificate".to_owned()),
                Err(QuicError::Spoilt(reason) | QuicError::Other(reason)) => last = failed(reason),
            }
        }
        Err(last)
    };
    tokio::time::timeout(patience, ask).await.map_err(|_| unreachable())?
}
