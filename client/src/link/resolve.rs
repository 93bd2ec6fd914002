//! Resolves a server's host name to an address that answers.

use std::{
    net::SocketAddr,
    time::{Duration, Instant},
};

use tokio::{net::lookup_host, time::timeout};

use super::url::ServerUrl;
use crate::error::ClientError;

/// Calls `attempt` with the addresses of `url` in turn, IPv4 first, and returns the first success.
///
/// # Errors
/// Errors with the last failure, or if nothing has answered within `limit`.
pub(super) async fn first_reachable<T, F>(
    url: &ServerUrl,
    limit: Duration,
    attempt: impl Fn(SocketAddr) -> F,
) -> Result<T, ClientError>
where
    F: Future<Output = Result<T, ClientError>>,
{
    let failed = |reason: String| ClientError::Connect { url: Box::new(url.clone()), reason };
    let unreachable = || ClientError::Unreachable { url: Box::new(url.clone()), after: limit };
    let deadline = Instant::now() + limit;
    let found = timeout(limit, lookup_host((url.host.as_str(), url.port)))
        .await
        .map_err(|_| unreachable())?
        .map_err(|error| failed(format!("host {:?}: {error}", url.host)))?;
    let mut addresses: Vec<SocketAddr> = found.collect();
    // UDP to a closed port may get no answer, and on small networks names usually mean the IPv4 address.
    addresses.sort_by_key(SocketAddr::is_ipv6);
    let mut last = failed(format!("host {:?} has no address", url.host));
    for (tried, address) in addresses.iter().enumerate() {
        let untried = u32::try_from(addresses.len() - tried).unwrap_or(u32::MAX);
        let share = deadline.saturating_duration_since(Instant::now()) / untried;
        match timeout(share, attempt(*address)).await {
            Ok(Ok(reached)) => return Ok(reached),
            Ok(Err(error)) => last = error,
            Err(_) => last = unreachable(),
        }
    }
    Err(last)
}
