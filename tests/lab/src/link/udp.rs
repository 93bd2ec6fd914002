//! A UDP relay on loopback: each client gets its own link to the server.

use std::{collections::HashMap, io, net::SocketAddr, sync::Arc, time::Duration};

use bytes::Bytes;
use tokio::{net::UdpSocket, sync::mpsc, task::JoinSet};

use super::{
    counters::{LinkCounts, Shared},
    flow,
    handle::{Relay, loopback_only},
    settings::LinkSettings,
};

const MAX_CLIENTS: usize = 64;
/// Most datagrams of a client that wait for its link.
const WAITING_DATAGRAMS: usize = 1024;
/// After a socket error.
pub(super) const BREATH: Duration = Duration::from_millis(1);

/// Listens on `listen` (port 0 takes a free one) and relays to `server`. The nth client's link has the seed plus n.
/// Needs a tokio runtime.
pub fn start(listen: SocketAddr, server: SocketAddr, settings: LinkSettings) -> io::Result<Relay> {
    start_counting(listen, server, settings, Shared::default())
}

/// Like [`start`], with shared counters.
pub(super) fn start_counting(
    listen: SocketAddr,
    server: SocketAddr,
    settings: LinkSettings,
    shared: Shared,
) -> io::Result<Relay> {
    let server = loopback_only(server)?;
    let listener = flow::socket(loopback_only(listen)?)?;
    let address = listener.local_addr()?;
    let task = tokio::spawn(relay(Arc::new(listener), server, settings, shared.clone())).abort_handle();
    Ok(Relay { address, shared, task })
}

async fn relay(listener: Arc<UdpSocket>, server: SocketAddr, settings: LinkSettings, shared: Shared) {
    let mut clients: HashMap<SocketAddr, mpsc::Sender<Bytes>> = HashMap::new();
    let mut links = JoinSet::new();
    let mut number = 0;
    let mut buffer = vec![0; flow::MAX_DATAGRAM_BYTES];
    loop {
        // Replies to clients that are gone surface as errors of this socket; other clients go on.
        let Ok((length, client)) = listener.recv_from(&mut buffer).await else {
            tokio::time::sleep(BREATH).await;
            continue;
        };
        // Results of ended links do not matter.
        while links.try_join_next().is_some() {}
        let datagram = Bytes::copy_from_slice(&buffer[..length]);
        let datagram = match clients.get(&client).map(|link| link.try_send(datagram.clone())) {
            Some(Ok(())) => continue,
            Some(Err(mpsc::error::TrySendError::Full(_))) => {
                shared.add(overrun());
                continue;
            }
            None | Some(Err(mpsc::error::TrySendError::Closed(_))) => datagram,
        };
        clients.retain(|_, link| !link.is_closed());
        if clients.len() >= MAX_CLIENTS || !client.ip().is_loopback() {
            shared.add(LinkCounts { refused: 1, ..LinkCounts::default() });
            continue;
        }
        let (link, datagrams) = mpsc::channel(WAITING_DATAGRAMS);
        let settings = LinkSettings { seed: settings.seed.wrapping_add(number), ..settings.clone() };
        number += 1;
        // The new channel has room for it.
        let _ = link.try_send(datagram);
        links.spawn(flow::carry(datagrams, Arc::clone(&listener), client, server, settings, shared.clone()));
        clients.insert(client, link);
    }
}

fn overrun() -> LinkCounts {
    let mut counts = LinkCounts::default();
    counts.up.arrived = 1;
    counts.up.overrun = 1;
    counts
}

#[cfg(test)]
mod tests {
    use std::net::Ipv4Addr;

    use tokio::time::timeout;

    use super::*;

    const FREE: SocketAddr = SocketAddr::new(std::net::IpAddr::V4(Ipv4Addr::LOCALHOST), 0);
    const PATIENCE: Duration = Duration::from_secs(30);

    async fn received(socket: &UdpSocket) -> (Vec<u8>, SocketAddr) {
        let mut buffer = vec![0; 2000];
        let (length, from) = timeout(PATIENCE, socket.recv_from(&mut buffer)).await.unwrap().unwrap();
        buffer.truncate(length);
        (buffer, from)
    }

    #[tokio::test]
    async fn clients_get_answers_to_their_own_questions() {
        let server = flow::socket(FREE).unwrap();
        let relay = start(FREE, server.local_addr().unwrap(), LinkSettings::default()).unwrap();
        let clients = [flow::socket(FREE).unwrap(), flow::socket(FREE).unwrap()];
        let mut addresses = Vec::new();
        for (number, client) in (0..).zip(&clients) {
            client.send_to(&[number; 100], relay.address()).await.unwrap();
            let (question, from) = received(&server).await;
            assert_eq!(question, [number; 100]);
            addresses.push(from);
        }
        assert_ne!(addresses[0], addresses[1]);
        for (number, address) in (10..).zip(&addresses) {
            server.send_to(&[number; 50], address).await.unwrap();
        }
        for (number, client) in (10..).zip(&clients) {
            assert_eq!(received(client).await, (vec![number; 50], relay.address()));
        }
        let counts = relay.counts();
        assert_eq!((counts.up.arrived, counts.up.delivered, counts.down.delivered), (2, 2, 2));
    }

    #[tokio::test]
    async fn a_dropped_relay_is_gone_with_all_its_links() {
        let server = flow::socket(FREE).unwrap();
        let relay = start(FREE, server.local_addr().unwrap(), LinkSettings::default()).unwrap();
        let address = relay.address();
        let client = flow::socket(FREE).unwrap();
        client.send_to(b"x", address).await.unwrap();
        let (_, link) = received(&server).await;
        drop(relay);
        // The ports are free once the tasks have ended.
        timeout(PATIENCE, async {
            while flow::socket(address).is_err() || flow::socket(link).is_err() {
                tokio::time::sleep(Duration::from_millis(1)).await;
            }
        })
        .await
        .unwrap();
    }

    #[tokio::test]
    async fn strangers_and_crowds_are_turned_away() {
        let other: SocketAddr = "192.0.2.1:9".parse().unwrap();
        for (listen, server) in [(FREE, other), (other, FREE), ("0.0.0.0:0".parse().unwrap(), FREE)] {
            let error = start(listen, server, LinkSettings::default()).unwrap_err();
            assert!(error.to_string().contains("is not loopback"), "{error}");
        }
        let server = flow::socket(FREE).unwrap();
        let relay = start(FREE, server.local_addr().unwrap(), LinkSettings::default()).unwrap();
        let mut clients = Vec::new();
        for _ in 0..MAX_CLIENTS {
            let client = flow::socket(FREE).unwrap();
            client.send_to(b"x", relay.address()).await.unwrap();
            received(&server).await;
            clients.push(client);
        }
        flow::socket(FREE).unwrap().send_to(b"x", relay.address()).await.unwrap();
        timeout(PATIENCE, async {
            while relay.counts().refused == 0 {
                tokio::time::sleep(Duration::from_millis(1)).await;
            }
        })
        .await
        .unwrap();
        assert_eq!(relay.counts().up.arrived, MAX_CLIENTS as u64);
    }
}
