//! Peers that get as far as a connection, and then do anything but enter.

use std::{
    pin::pin,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    time::Duration,
};

use anyhow::Result;
use gnomon_protocol::{
    PROTOCOL_VERSION,
    codec::CodecId,
    message::{self, ClientMessage, Hello},
};
use tokio::task::JoinSet;

use super::{
    addresses::Addresses,
    packets::Noise,
    peers::{Peers, Protocol, WebStreams, web_session},
};

/// Peers at once.
const AT_ONCE: usize = 256;

/// A connection that the server has not closed by then is one that it leaves open.
const CLOSES_WITHIN: Duration = Duration::from_secs(30);

#[derive(Debug, Clone, Copy)]
pub(super) enum Attack {
    /// Nothing after QUIC's handshake.
    Silence,
    /// A WebTransport session without a stream: 400 of these stayed open for good, at 110 kB each.
    EmptySession,
    HalfHello,
    /// Random bytes on all streams that the server allows.
    Streams,
    Datagrams,
    /// Capsules of an unknown type, as small as can be: a library logged each.
    Capsules,
    /// Capsules that are longer than they say, or that never end.
    BrokenCapsules,
}

impl Attack {
    pub(super) const fn all(protocol: Protocol) -> &'static [Self] {
        match protocol {
            Protocol::Native => &[Self::Silence, Self::HalfHello, Self::Streams, Self::Datagrams],
            Protocol::Web => &[
                Self::Silence,
                Self::EmptySession,
                Self::HalfHello,
                Self::Streams,
                Self::Datagrams,
                Self::Capsules,
                Self::BrokenCapsules,
            ],
        }
    }

    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::Silence => "silence",
            Self::EmptySession => "an empty session",
            Self::HalfHello => "half a Hello",
            Self::Streams => "random streams",
            Self::Datagrams => "random datagrams",
            Self::Capsules => "unknown capsules",
            Self::BrokenCapsules => "broken capsules",
        }
    }

    /// Whether it sends as much as it can.
    const fn is_loud(self) -> bool {
        !matches!(self, Self::Silence | Self::EmptySession | Self::HalfHello)
    }
}

/// What peers did, and what became of them.
#[derive(Debug, Default)]
pub(super) struct Tally {
    /// Handshakes that completed.
    pub(super) connected: u64,
    /// Handshakes that the server refused.
    pub(super) refused: u64,
    /// Connections that the server left open.
    pub(super) left_open: u64,
    /// Bytes that peers could send.
    pub(super) bytes: u64,
}

/// Runs `connections` peers, which together send up to about `bytes`, and waits until the server has closed them.
pub(super) async fn run(
    attack: Attack,
    protocol: Protocol,
    addresses: &Addresses,
    connections: usize,
    bytes: u64,
) -> Result<Tally> {
    let peers = Arc::new(Peers::new(addresses, protocol)?);
    let left = Arc::new(AtomicU64::new(bytes));
    let mut tasks = JoinSet::new();
    let mut tally = Tally::default();
    for number in 0..connections {
        if tasks.len() >= AT_ONCE {
            tally.join(&mut tasks).await;
        }
        let (peers, left) = (Arc::clone(&peers), Arc::clone(&left));
        tasks.spawn(async move {
            let connection = peers.connect(number).await.ok()?;
            let mut acting = pin!(act(attack, protocol, &connection, &left));
            let over = async {
                // The server may break it off at any point. Its streams stay open until the verdict.
                let _ = (&mut acting).await;
                connection.closed().await
            };
            Some(tokio::time::timeout(CLOSES_WITHIN, over).await.is_ok())
        });
    }
    while !tasks.is_empty() {
        tally.join(&mut tasks).await;
    }
    tally.bytes = bytes - left.load(Ordering::Relaxed);
    peers.close();
    Ok(tally)
}

impl Tally {
    /// Waits for a peer, and counts it.
    async fn join(&mut self, peers: &mut JoinSet<Option<bool>>) {
        match peers.join_next().await {
            Some(Ok(Some(closed))) => {
                self.connected += 1;
                self.left_open += u64::from(!closed);
            }
            Some(Ok(None)) => self.refused += 1,
            _ => {}
        }
    }
}

/// Sends, then keeps everything open until the server closes the connection.
async fn act(attack: Attack, protocol: Protocol, connection: &quinn::Connection, left: &Arc<AtomicU64>) -> Result<()> {
    let web = match (attack, protocol) {
        (Attack::Silence, _) | (_, Protocol::Native) => None,
        (_, Protocol::Web) => Some(web_session(connection).await?),
    };
    if attack.is_loud() {
        loud(attack, connection, web, left).await?;
        return Ok(());
    }
    let _stream = match attack {
        Attack::HalfHello => {
            let (mut send, receive) = connection.open_bi().await?;
            if web.is_some() {
                send.write_all(&WEB_STREAM).await?;
            }
            let hello = hello();
            send.write_all(&hello[..hello.len() / 2]).await?;
            Some((send, receive))
        }
        _ => None,
    };
    connection.closed().await;
    Ok(())
}

/// Head of a stream of the WebTransport session 0.
const WEB_STREAM: [u8; 3] = [0x40, 0x41, 0];

async fn loud(
    attack: Attack,
    connection: &quinn::Connection,
    web: Option<WebStreams>,
    left: &Arc<AtomicU64>,
) -> Result<()> {
    let mut noise = Noise::new();
    let mut bytes = vec![0; 32 * 1024];
    noise.fill(&mut bytes);
    match (attack, web) {
        (Attack::Datagrams, web) => {
            while take(left, 1000) {
                connection.send_datagram_wait(bytes[..1000].to_vec().into()).await?;
            }
            connection.closed().await;
            drop(web);
        }
        (Attack::Capsules, Some(mut web)) => {
            // DATA frames with one empty capsule each.
            let flood = [0, 2, 0x21, 0].repeat(8 * 1024);
            while take(left, flood.len()) {
                web.request.write_all(&flood).await?;
            }
            connection.closed().await;
        }
        (Attack::BrokenCapsules, Some(mut web)) => {
            // A DATA frame that announces a capsule of 60,000 bytes, and then short ones for ever.
            web.request.write_all(&[0, 5, 0x21, 0x80, 0, 0xea, 0x60]).await?;
            while take(left, bytes.len()) {
                for part in bytes.chunks(61) {
                    web.request.write_all(&[0, 61]).await?;
                    web.request.write_all(part).await?;
                }
            }
            connection.closed().await;
        }
        (_, web) => {
            let mut streams = JoinSet::new();
            // As many as the server allows; it may allow no more.
            for _ in 0..4 {
                let (connection, bytes, left) = (connection.clone(), bytes.clone(), Arc::clone(left));
                let head = if web.is_some() { &WEB_STREAM[..] } else { &[] };
                streams.spawn(async move {
                    let (mut send, _receive) = connection.open_bi().await?;
                    send.write_all(head).await?;
                    while take(&left, bytes.len()) {
                        send.write_all(&bytes).await?;
                    }
                    connection.closed().await;
                    anyhow::Ok(())
                });
            }
            connection.closed().await;
        }
    }
    Ok(())
}

/// Takes bytes of what may be sent yet.
fn take(left: &AtomicU64, bytes: usize) -> bool {
    left.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |left| left.checked_sub(bytes as u64)).is_ok()
}

fn hello() -> Vec<u8> {
    let hello = Hello {
        version: PROTOCOL_VERSION,
        token: None,
        client: "hostile".to_owned().into(),
        width: 64,
        height: 64,
        codec: CodecId::PlanesLz4,
        rate_hz: 1,
        wrong_ppm: 0,
        resume: None,
    };
    message::encode(&ClientMessage::Hello(hello)).unwrap_or_default()
}
