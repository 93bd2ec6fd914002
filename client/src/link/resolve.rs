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
    let deadline = Instant::now() + limit;
    let found = timeout(limit, lookup_host((url.host.as_str(), url.port)))
        .await
        .map_err(|_| ClientError::Unreachable { url: Box::new(url.clone()), after: limit })?
        .map_err(|error| failed(format!("host {:?}: {error}", url.host)))?;
    let mut addresses: Vec<SocketAddr> = found.collect();
    // UDP to a closed port may get no answer, and on small networks names usually mean the IPv4 address.
    addresses.sort_by_key(SocketAddr::is_ipv6);
    first_of(&addresses, url, (limit, deadline), attempt).await
}

/// Tries the addresses in turn. Each has an equal share of the time that is left, so a silent one costs no other its
/// turn.
async fn first_of<T, F>(
    addresses: &[SocketAddr],
    url: &ServerUrl,
    (limit, deadline): (Duration, Instant),
    attempt: impl Fn(SocketAddr) -> F,
) -> Result<T, ClientError>
where
    F: Future<Output = Result<T, ClientError>>,
{
    let failed = |reason: String| ClientError::Connect { url: Box::new(url.clone()), reason };
    let unreachable = || ClientError::Unreachable { url: Box::new(url.clone()), after: limit };
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

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn every_address_has_its_turn() {
        let url: ServerUrl = "gnomon://edge.example:1/?cert=first-use".parse().unwrap();
        let addresses: Vec<SocketAddr> =
            ["192.0.2.1:1", "[::1]:1", "192.0.2.3:1"].into_iter().map(|address| address.parse().unwrap()).collect();
        let tried = std::sync::Mutex::new(Vec::new());
        // The first is silent, the second refuses.
        let attempt = |address: SocketAddr| {
            tried.lock().unwrap().push(address);
            let (url, place) = (Box::new(url.clone()), tried.lock().unwrap().len());
            async move {
                match place {
                    1 => std::future::pending().await,
                    2 => Err(ClientError::Connect { url, reason: "refused".to_owned() }),
                    _ => Ok(address),
                }
            }
        };
        let limit = Duration::from_millis(600);
        let soon = || (limit, Instant::now() + limit);
        assert_eq!(first_of(&addresses, &url, soon(), attempt).await.unwrap(), addresses[2]);
        assert_eq!(*tried.lock().unwrap(), addresses);
        tried.lock().unwrap().clear();
        let error = first_of(&addresses[..2], &url, soon(), attempt).await.unwrap_err();
        assert!(error.to_string().ends_with("refused"), "the last failure is told: {error}");
        tried.lock().unwrap().clear();
        let silent = first_of(&addresses[..1], &url, soon(), attempt).await.unwrap_err().to_string();
        assert!(silent.contains("within 0.6 s"), "{silent}");
        assert!(first_of(&[], &url, soon(), attempt).await.unwrap_err().to_string().contains("no address"));
    }
}
