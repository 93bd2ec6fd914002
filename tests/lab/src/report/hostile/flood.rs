//! Handshakes that complete and then stay silent: each occupies one of the server's handshake slots until it times out.

use std::{
    sync::atomic::{AtomicBool, Ordering},
    time::Duration,
};

use anyhow::Result;
use tokio::{runtime::Handle, task::JoinSet};

use super::{
    addresses::Addresses,
    peers::{Peers, Protocol},
};

/// More than the server has places for.
const AT_ONCE: usize = 1024;

/// Starts up to `handshakes` while `flooding`, and returns how many.
pub(super) fn run(runtime: &Handle, addresses: &Addresses, handshakes: usize, flooding: &AtomicBool) -> Result<usize> {
    runtime.block_on(async {
        let [native, web] = Protocol::BOTH.map(|protocol| Peers::new(addresses, protocol).map(std::sync::Arc::new));
        let peers = [native?, web?];
        let mut tasks = JoinSet::new();
        let mut begun = 0;
        while begun < handshakes && flooding.load(Ordering::Relaxed) {
            if tasks.len() >= AT_ONCE {
                tasks.join_next().await;
            }
            let its = std::sync::Arc::clone(&peers[begun % peers.len()]);
            let number = begun / peers.len();
            begun += 1;
            tasks.spawn(async move {
                if let Ok(connection) = its.connect(number).await {
                    // Stays silent until the server closes.
                    let _ = tokio::time::timeout(Duration::from_secs(10), connection.closed()).await;
                }
            });
            // Faster than any address may, and slow enough to last.
            tokio::time::sleep(Duration::from_micros(500)).await;
        }
        while flooding.load(Ordering::Relaxed) {
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
        peers.iter().for_each(|peers| peers.close());
        Ok(begun)
    })
}
