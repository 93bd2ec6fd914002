//! A connection to a server over any transport: the control stream, and the data beside it.

use std::{
    io,
    net::SocketAddr,
    sync::Arc,
    time::{Duration, Instant},
};

use bytes::Bytes;
use gnomon_protocol::{
    limits::{MAX_LAB_PACKET_BYTES, MAX_MESSAGE_BYTES},
    message::{ClientMessage, ServerMessage, Welcome},
};
use gnomon_transport::{
    baseline::{self, PacketReader, PacketWriter},
    control::{ControlReader, ControlWriter},
};
use tokio::{
    io::{AsyncRead, AsyncWrite},
    net::{UdpSocket, lookup_host},
};

use super::{
    baseline::UdpReceiver,
    quic::{self, QuicError, Trust},
    url::{ServerUrl, Transport},
};
use crate::error::ClientError;

/// How long the farewell may take.
const FAREWELL: Duration = Duration::from_millis(500);

/// How long the server may leave a control message unread.
const WRITE_TIMEOUT: Duration = Duration::from_secs(10);

/// A server that has been connected to.
pub(crate) struct Link {
    pub(crate) reader: ControlReader<ServerMessage>,
    pub(crate) writer: ControlWriter<ClientMessage>,
    kind: LinkKind,
    server: SocketAddr,
}

enum LinkKind {
    Quic(quinn::Endpoint, quinn::Connection),
    LabUdp,
    LabTcp,
}

/// Poses go out here.
pub(crate) enum DataSender {
    Quic(quinn::Connection),
    Udp(Arc<UdpSocket>),
    Tcp(PacketWriter),
}

/// Frame packets come in here.
pub(crate) struct DataReceiver(Receiver);

enum Receiver {
    Quic { connection: quinn::Connection, datagram: Bytes },
    Udp(UdpReceiver),
    Tcp { stream: PacketReader, packet: Bytes },
}

/// Counts what comes in over a link.
#[derive(Debug)]
pub(crate) struct Watcher(Option<quinn::Connection>);

impl Watcher {
    /// UDP datagrams that have come, whatever was in them; `None` where the link ends by itself when the server does.
    pub(crate) fn arrived(&self) -> Option<u64> {
        self.0.as_ref().map(|connection| connection.stats().udp_rx.datagrams)
    }
}

/// What is left of a link when its data is in other hands.
#[derive(Debug)]
pub(crate) struct Closer(Option<(quinn::Endpoint, quinn::Connection)>);

impl Link {
    /// Connects to `url`, within `patience`.
    pub(crate) async fn connect(url: &ServerUrl, patience: Duration) -> Result<Self, ClientError> {
        let failed = |reason: String| ClientError::Connect { url: Box::new(url.clone()), reason };
        let unreachable = || ClientError::Unreachable { url: Box::new(url.clone()), after: patience };
        let found = tokio::time::timeout(patience, lookup_host((url.host.as_str(), url.port)))
            .await
            .map_err(|_| unreachable())?
            .map_err(|error| failed(format!("host {:?}: {error}", url.host)))?;
        let mut addresses: Vec<SocketAddr> = found.collect();
        // UDP to a port where nobody listens just gets no answer; IPv4 is what a name on a small network means.
        addresses.sort_by_key(SocketAddr::is_ipv6);
        let deadline = Instant::now() + patience;
        let mut last = failed(format!("host {:?} has no address", url.host));
        for (tried, address) in addresses.iter().enumerate() {
            let untried = u32::try_from(addresses.len() - tried).unwrap_or(u32::MAX);
            let share = deadline.saturating_duration_since(Instant::now()) / untried;
            match tokio::time::timeout(share, Self::connect_to(url, *address)).await {
                Ok(Ok(link)) => return Ok(link),
                Ok(Err(error)) => last = error,
                Err(_) => last = unreachable(),
            }
        }
        Err(last)
    }

    async fn connect_to(url: &ServerUrl, server: SocketAddr) -> Result<Self, ClientError> {
        let failed = |reason: String| ClientError::Connect { url: Box::new(url.clone()), reason };
        let kind = match url.transport {
            Transport::Quic => {
                let trust = match (url.certificate, &url.ca) {
                    (Some(digest), _) => Trust::Pinned(digest),
                    (None, Some(file)) => Trust::Authority { file, name: &url.host },
                    (None, None) => return Err(failed("the URL names no certificate".to_owned())),
                };
                let (endpoint, connection) = quic::connect(server, trust).await.map_err(|error| match error {
                    QuicError::Certificate => ClientError::Certificate(Box::new(url.clone())),
                    QuicError::TimedOut => {
                        ClientError::Unreachable { url: Box::new(url.clone()), after: quic::IDLE_TIMEOUT }
                    }
                    QuicError::Spoilt(reason) | QuicError::Other(reason) => failed(reason),
                })?;
                let (writer, reader) = connection.open_bi().await.map_err(|error| failed(error.to_string()))?;
                let kind = LinkKind::Quic(endpoint, connection);
                return Ok(Self::new(reader, writer, kind, server));
            }
            Transport::LabUdp => LinkKind::LabUdp,
            Transport::LabTcp => LinkKind::LabTcp,
        };
        let stream = baseline::connect_tcp(server).await.map_err(|error| {
            let transport = url.transport.name();
            failed(format!("{error}; is gnomon-server running there with --transport {transport}?"))
        })?;
        let (reader, writer) = stream.into_split();
        Ok(Self::new(reader, writer, kind, server))
    }

    fn new(
        reader: impl AsyncRead + Send + Unpin + 'static,
        writer: impl AsyncWrite + Send + Unpin + 'static,
        kind: LinkKind,
        server: SocketAddr,
    ) -> Self {
        let reader = ControlReader::new(reader, MAX_MESSAGE_BYTES);
        Self { reader, writer: ControlWriter::new(writer, WRITE_TIMEOUT), kind, server }
    }

    /// The server's reason when it closed the connection with one.
    pub(crate) fn close_reason(&self) -> Option<String> {
        let LinkKind::Quic(_, connection) = &self.kind else { return None };
        match connection.close_reason()? {
            quinn::ConnectionError::ApplicationClosed(close) if !close.reason.is_empty() => {
                Some(String::from_utf8_lossy(&close.reason).into_owned())
            }
            error => Some(error.to_string()),
        }
    }

    /// Opens what carries the data, and takes the link apart.
    pub(crate) async fn open_data(
        self,
        welcome: &Welcome,
    ) -> io::Result<(ControlReader<ServerMessage>, ControlWriter<ClientMessage>, DataSender, DataReceiver, Closer)>
    {
        let data_server = || {
            let port = welcome.data_port.ok_or_else(|| io::Error::other("the server named no data port"))?;
            Ok::<_, io::Error>(SocketAddr::new(self.server.ip(), port))
        };
        let mut closer = Closer(None);
        let (sender, receiver) = match self.kind {
            LinkKind::Quic(endpoint, connection) => {
                closer.0 = Some((endpoint, connection.clone()));
                let receiver = Receiver::Quic { connection: connection.clone(), datagram: Bytes::new() };
                (DataSender::Quic(connection), receiver)
            }
            LinkKind::LabUdp => {
                let socket = Arc::new(baseline::connect_udp(data_server()?).await?);
                (DataSender::Udp(Arc::clone(&socket)), Receiver::Udp(UdpReceiver::new(socket)))
            }
            LinkKind::LabTcp => {
                let (read, write) = baseline::connect_tcp(data_server()?).await?.into_split();
                let stream = PacketReader::new(read, MAX_LAB_PACKET_BYTES);
                (DataSender::Tcp(PacketWriter::new(write)), Receiver::Tcp { stream, packet: Bytes::new() })
            }
        };
        Ok((self.reader, self.writer, sender, DataReceiver(receiver), closer))
    }
}

impl DataSender {
    /// Sends one packet. A datagram that does not get through is the next one's business.
    pub(crate) async fn send(&mut self, packet: &[u8]) -> io::Result<()> {
        match self {
            Self::Quic(connection) => {
                connection.send_datagram(Bytes::copy_from_slice(packet)).map_err(io::Error::other)
            }
            Self::Udp(socket) => baseline::send_udp(socket, packet).await,
            Self::Tcp(stream) => {
                stream.send(packet).await?;
                stream.flush().await
            }
        }
    }
}

impl DataReceiver {
    /// The next packet.
    pub(crate) async fn receive(&mut self) -> io::Result<&[u8]> {
        match &mut self.0 {
            Receiver::Quic { connection, datagram } => {
                *datagram = connection.read_datagram().await.map_err(io::Error::other)?;
                Ok(datagram)
            }
            Receiver::Udp(receiver) => receiver.receive().await,
            Receiver::Tcp { stream, packet } => {
                *packet = stream.receive().await?;
                Ok(packet)
            }
        }
    }
}

impl Closer {
    /// Counts what comes in.
    pub(crate) fn watcher(&self) -> Watcher {
        Watcher(self.0.as_ref().map(|(_, connection)| connection.clone()))
    }

    /// QUIC's own measure of the round trip.
    pub(crate) fn rtt(&self) -> Option<Duration> {
        self.0.as_ref().map(|(_, connection)| connection.rtt())
    }

    /// Waits a moment for the server to end the connection, then ends it.
    pub(crate) async fn close(self) {
        if let Some((endpoint, connection)) = self.0 {
            let _ = tokio::time::timeout(FAREWELL, connection.closed()).await;
            connection.close(0_u32.into(), b"done");
            let _ = tokio::time::timeout(FAREWELL, endpoint.wait_idle()).await;
        }
    }
}
