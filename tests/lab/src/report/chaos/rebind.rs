//! A relay that changes its port towards the server, as a client does that moves to another network.

use std::{net::SocketAddr, sync::Arc, time::Duration};

use anyhow::Result;
use tokio::{net::UdpSocket, sync::watch, task::JoinHandle};

/// A relay for one client. Dropping it ends it.
pub(super) struct Rebinding {
    pub(super) address: SocketAddr,
    rebindings: watch::Receiver<u32>,
    task: JoinHandle<()>,
}

impl Rebinding {
    /// Listens on a free port, and changes the port towards the server every `period`.
    pub(super) async fn start(server: SocketAddr, period: Duration) -> Result<Self> {
        let inner = Arc::new(UdpSocket::bind("127.0.0.1:0").await?);
        let address = inner.local_addr()?;
        let (count, rebindings) = watch::channel(0);
        let task = tokio::spawn(async move {
            // A socket error ends the relay and so the session, which the measurement reports.
            let _ = relay(&inner, server, period, &count).await;
        });
        Ok(Self { address, rebindings, task })
    }

    pub(super) fn rebindings(&self) -> u32 {
        *self.rebindings.borrow()
    }
}

impl Drop for Rebinding {
    fn drop(&mut self) {
        self.task.abort();
    }
}

async fn relay(
    inner: &UdpSocket,
    server: SocketAddr,
    period: Duration,
    count: &watch::Sender<u32>,
) -> std::io::Result<()> {
    let mut client = None;
    let mut outer = UdpSocket::bind("127.0.0.1:0").await?;
    let mut ticks = tokio::time::interval(period);
    ticks.tick().await;
    let (mut from_client, mut from_server) = ([0; 2048], [0; 2048]);
    loop {
        tokio::select! {
            received = inner.recv_from(&mut from_client) => {
                let (length, from) = received?;
                client = Some(from);
                outer.send_to(&from_client[..length], server).await?;
            }
            received = outer.recv_from(&mut from_server) => {
                let (length, _) = received?;
                if let Some(client) = client {
                    inner.send_to(&from_server[..length], client).await?;
                }
            }
            _ = ticks.tick() => {
                outer = UdpSocket::bind("127.0.0.1:0").await?;
                count.send_modify(|count| *count += 1);
            }
        }
    }
}
