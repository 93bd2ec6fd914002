//! A relay for `lab-udp`: a delayed, lossless TCP control connection, and a link for the data port agreed on it.

use std::{io, net::SocketAddr, sync::Arc, time::Duration};

use bytes::Bytes;
use gnomon_protocol::message::{self, ServerMessage};
use tokio::{
    io::{AsyncRead, AsyncReadExt as _, AsyncWrite, AsyncWriteExt as _},
    net::{TcpListener, TcpStream},
    sync::{Semaphore, mpsc},
    task::JoinSet,
    time::{Instant, sleep_until},
};

use super::{
    counters::{LinkCounts, Shared},
    handle::{Relay, loopback_only},
    settings::LinkSettings,
    udp::{self, BREATH},
};

const MAX_CLIENTS: usize = 64;
/// Most pieces of a connection in flight.
const WAITING_PIECES: usize = 64;
const PIECE_BYTES: usize = 64 << 10;

/// Listens on `listen` (port 0 takes a free one) and relays to the control port `server` of a `lab-udp` server. Needs a
/// tokio runtime.
pub async fn start(listen: SocketAddr, server: SocketAddr, settings: LinkSettings) -> io::Result<Relay> {
    let server = loopback_only(server)?;
    let listener = TcpListener::bind(loopback_only(listen)?).await?;
    let address = listener.local_addr()?;
    let shared = Shared::default();
    let task = tokio::spawn(accept(listener, server, settings, shared.clone())).abort_handle();
    Ok(Relay { address, shared, task })
}

async fn accept(listener: TcpListener, server: SocketAddr, settings: LinkSettings, shared: Shared) {
    let places = Arc::new(Semaphore::new(MAX_CLIENTS));
    let mut conversations = JoinSet::new();
    let mut number = 0;
    loop {
        let Ok((client, _)) = listener.accept().await else {
            // For example, too many open files.
            tokio::time::sleep(BREATH).await;
            continue;
        };
        while conversations.try_join_next().is_some() {}
        let Ok(place) = Arc::clone(&places).try_acquire_owned() else {
            shared.add(LinkCounts { refused: 1, ..LinkCounts::default() });
            continue;
        };
        let settings = LinkSettings { seed: settings.seed.wrapping_add(number), ..settings.clone() };
        number += 1;
        let shared = shared.clone();
        conversations.spawn(async move {
            // Both peers see their streams close, however this ends.
            let _ = converse(client, server, settings, shared).await;
            drop(place);
        });
    }
}

async fn converse(client: TcpStream, server: SocketAddr, settings: LinkSettings, shared: Shared) -> io::Result<()> {
    let to_server = TcpStream::connect(server).await?;
    client.set_nodelay(true)?;
    to_server.set_nodelay(true)?;
    let (client_read, client_write) = client.into_split();
    let (server_read, server_write) = to_server.into_split();
    let (up_delay, down_delay) = (settings.up.delay, settings.down.delay);
    let up = delayed(up_delay, server_write, |pieces| copy(client_read, pieces));
    let down = delayed(down_delay, client_write, |pieces| copy_messages(server_read, pieces, server, settings, shared));
    // Each direction ends by itself: a peer may close its side and still receive.
    tokio::try_join!(up, down).map(drop)
}

async fn delayed<F: Future<Output = io::Result<()>>>(
    delay: Duration,
    mut out: impl AsyncWrite + Unpin,
    fill: impl FnOnce(mpsc::Sender<(Instant, Bytes)>) -> F,
) -> io::Result<()> {
    let (pieces, mut waiting) = mpsc::channel::<(Instant, Bytes)>(WAITING_PIECES);
    let empty = async {
        while let Some((arrived, piece)) = waiting.recv().await {
            sleep_until(arrived + delay).await;
            out.write_all(&piece).await?;
        }
        out.shutdown().await
    };
    tokio::try_join!(fill(pieces), empty).map(drop)
}

async fn copy(mut from: impl AsyncRead + Unpin, pieces: mpsc::Sender<(Instant, Bytes)>) -> io::Result<()> {
    let mut buffer = vec![0; PIECE_BYTES];
    loop {
        let length = from.read(&mut buffer).await?;
        if length == 0 {
            return Ok(());
        }
        send(&pieces, Bytes::copy_from_slice(&buffer[..length])).await?;
    }
}

/// Copies the server's Welcome with the data port replaced by a link's, then bytes unchanged.
async fn copy_messages(
    mut from: impl AsyncRead + Unpin,
    pieces: mpsc::Sender<(Instant, Bytes)>,
    server: SocketAddr,
    settings: LinkSettings,
    shared: Shared,
) -> io::Result<()> {
    let invalid = |error: message::MessageError| io::Error::new(io::ErrorKind::InvalidData, error.to_string());
    let mut prefix = [0; 4];
    from.read_exact(&mut prefix).await?;
    let mut body = vec![0; message::decode_length(prefix).map_err(invalid)?];
    from.read_exact(&mut body).await?;
    // The link lives as long as the connection.
    let mut _link = None;
    let first = match message::decode(&body) {
        Ok(ServerMessage::Welcome(mut welcome)) => {
            if let Some(port) = welcome.data_port {
                let free = SocketAddr::new(server.ip(), 0);
                let link = udp::start_counting(free, SocketAddr::new(server.ip(), port), settings, shared)?;
                welcome.data_port = Some(link.address().port());
                _link = Some(link);
            }
            message::encode(&ServerMessage::Welcome(welcome)).map_err(invalid)?
        }
        // A refusal, or a message for the client to judge.
        _ => [&prefix[..], &body].concat(),
    };
    send(&pieces, first.into()).await?;
    copy(from, pieces).await
}

async fn send(pieces: &mpsc::Sender<(Instant, Bytes)>, piece: Bytes) -> io::Result<()> {
    pieces.send((Instant::now(), piece)).await.map_err(|_| io::ErrorKind::BrokenPipe.into())
}
