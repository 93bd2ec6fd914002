//! The first visit of a server that no URL identifies (`?cert=first-use`), as ssh does it: its certificate is shown to
//! a person and kept on the disk before a token goes there. Later visits accept that certificate only.

use std::time::Duration;

use super::servers::{KnownServers, fingerprint};
use crate::{
    error::ClientError,
    link::{certificate::fetch_certificate, url::ServerUrl},
};

/// What a first visit may do.
pub(crate) struct FirstVisit<'a> {
    pub(crate) connect_timeout: Duration,
    /// Whether a token goes to the server afterwards. Without one nothing is at stake that needs a person.
    pub(crate) sends_token: bool,
    /// Asks whether the server that showed this certificate is the one that is meant.
    pub(crate) trusts: &'a mut dyn FnMut(&ServerUrl, &[u8; 32]) -> bool,
}

impl FirstVisit<'_> {
    /// Returns the URL with the certificate that was pinned before, or is pinned now.
    ///
    /// # Errors
    /// Errors if the server does not answer, nobody trusts it, or its certificate cannot be kept.
    pub(crate) async fn identify(self, url: &ServerUrl, known: &mut KnownServers) -> Result<ServerUrl, ClientError> {
        let not_kept = |source| ClientError::NotPinned { url: Box::new(url.clone()), source };
        if let Some(pinned) = known.pinned(url).map_err(not_kept)? {
            return Ok(ServerUrl { certificates: pinned.certificates.clone(), ..url.clone() });
        }
        let digest = fetch_certificate(url, self.connect_timeout).await?;
        if self.sends_token && !(self.trusts)(url, &digest) {
            return Err(ClientError::FirstVisit { url: Box::new(url.clone()), digest });
        }
        let pinned = ServerUrl { certificates: vec![digest], ..url.clone() };
        known.pin(&pinned).map_err(not_kept)?;
        tracing::warn!(server = %url, certificate = fingerprint(&digest), "first visit: pinned");
        Ok(pinned)
    }
}
