//! A connection to a server over any transport: the control stream and the data channel.

use std::{io, net::SocketAddr, sync::Arc, time::Duration};

use bytes::Bytes;
use gnomon_protocol::{
    limits::{MAX_LAB_PACKET_BYTES, MAX_MESSAGE_BYTES},
    message::{ClientMessage, ServerMessage, Welcome},
    text::{Escaped, PeerText},
};
use gnomon_transport::{
    baseline::{self, PacketReader, PacketWriter},
    control::{ControlReader, ControlWriter},
    root_cause,
};
use tokio::{
    io::{AsyncRead, AsyncWrite},
    net::UdpSocket,
    time::timeout,
};

use super::{
    baseline::UdpReceiver,
    quic::{self, Trust},
    resolve::first_reachable,
    url::{ServerUrl, Transport},
};
use crate::error::ClientError;

/// Time for each of the two steps that end a connection.
const CLOSE_TIMEOUT: Duration = Duration::from_millis(500);

/// How long the server may leave a control message unread.
const WRITE_TIMEOUT: Duration = Duration::from_secs(10);

/// A connection before the data channel is open.
pub(crate) struct ServerConnection {
    pub(crate) reader: ControlReader<ServerMessage>,
    pub(crate) writer: ControlWriter<ClientMessage>,
    transport: TransportHandle,
    server: SocketAddr,
}

enum TransportHandle {
    Quic(quinn::Endpoint, quinn::Connection),
    LabUdp,
    LabTcp,
}

/// A connection ready for poses and masks.
pub(crate) struct OpenConnection {
    pub(crate) reader: ControlReader<ServerMessage>,
    pub(crate) writer: ControlWriter<ClientMessage>,
    pub(crate) sender: DataSender,
    pub(crate) receiver: DataReceiver,
    pub(crate) quic: QuicHandle,
}

/// Sends poses and feedback.
pub(crate) enum DataSender {
    Quic(quinn::Connection),
    Udp(Arc<UdpSocket>),
    Tcp(PacketWriter),
}

pub(crate) enum DataReceiver {
    Quic(quinn::Connection),
    Udp(UdpReceiver),
    Tcp(PacketReader),
}

/// The QUIC connection, to close it. Empty for the lab transports, which close when their sockets are dropped.
#[derive(Debug, Clone)]
pub(crate) struct QuicHandle(Option<(quinn::Endpoint, quinn::Connection)>);

impl ServerConnection {
    /// Connects to `url`.
    ///
    /// # Errors
    /// Errors if no address answers within `limit`, or the server shows another certificate.
    pub(crate) async fn connect(url: &ServerUrl, limit: Duration) -> Result<Self, ClientError> {
        first_reachable(url, limit, |address| Self::connect_to(url, address)).await
    }

    async fn connect_to(url: &ServerUrl, server: SocketAddr) -> Result<Self, ClientError> {
        let failed = |reason: String| ClientError::Connect { url: Box::new(url.clone()), reason };
        let transport = match url.transport {
            Transport::Quic => {
                let trust = match &url.ca {
                    _ if !url.certificates.is_empty() => Trust::Pinned(&url.certificates),
                    Some(file) => Trust::Authority { file, name: url.name() },
                    None => return Err(failed("the URL names no certificate".to_owned())),
                };
                let (endpoint, connection) =
                    quic::connect(server, trust).await.map_err(|error| error.at_server(url))?;
                let (writer, reader) = connection.open_bi().await.map_err(|error| failed(root_cause(&error)))?;
                return Ok(Self::new(reader, writer, TransportHandle::Quic(endpoint, connection), server));
            }
            Transport::LabUdp => TransportHandle::LabUdp,
            Transport::LabTcp => TransportHandle::LabTcp,
        };
        let stream = baseline::connect_tcp(server).await.map_err(|error| {
            let name = url.transport.name();
            failed(format!("{error}; is gnomon-server running there with --transport {name}?"))
        })?;
        let (reader, writer) = stream.into_split();
        Ok(Self::new(reader, writer, transport, server))
    }

    fn new(
        reader: impl AsyncRead + Send + Unpin + 'static,
        writer: impl AsyncWrite + Send + Unpin + 'static,
        transport: TransportHandle,
        server: SocketAddr,
    ) -> Self {
        let reader = ControlReader::new(reader, MAX_MESSAGE_BYTES);
        Self { reader, writer: ControlWriter::new(writer, WRITE_TIMEOUT), transport, server }
    }

    /// Returns a handle that can close the connection.
    pub(crate) fn quic(&self) -> QuicHandle {
        match &self.transport {
            TransportHandle::Quic(endpoint, connection) => QuicHandle(Some((endpoint.clone(), connection.clone()))),
            TransportHandle::LabUdp | TransportHandle::LabTcp => QuicHandle(None),
        }
    }

    /// Returns why the connection closed, preferring the server's reason. `None` while it is open, and on lab
    /// transports.
    pub(crate) fn close_reason(&self) -> Option<String> {
        let TransportHandle::Quic(_, connection) = &self.transport else { return None };
        match connection.close_reason()? {
            quinn::ConnectionError::ApplicationClosed(close) if !close.reason.is_empty() => {
                Some(PeerText::from_bytes(&close.reason).to_string())
            }
            error => Some(Escaped(error).to_string()),
        }
    }

    /// Opens the data channel.
    ///
    /// # Errors
    /// Errors on lab transports if the server's data port cannot be reached.
    pub(crate) async fn open_data(self, welcome: &Welcome) -> io::Result<OpenConnection> {
        let data_server = || {
            let port = welcome.data_port.ok_or_else(|| io::Error::other("the server named no data port"))?;
            Ok::<_, io::Error>(SocketAddr::new(self.server.ip(), port))
        };
        let (sender, receiver, quic) = match self.transport {
            TransportHandle::Quic(endpoint, connection) => {
                let (sender, receiver) = (DataSender::Quic(connection.clone()), DataReceiver::Quic(connection.clone()));
                (sender, receiver, Some((endpoint, connection)))
            }
            TransportHandle::LabUdp => {
                let socket = Arc::new(baseline::connect_udp(data_server()?).await?);
                (DataSender::Udp(Arc::clone(&socket)), DataReceiver::Udp(UdpReceiver::new(socket)), None)
            }
            TransportHandle::LabTcp => {
                let (read, write) = baseline::connect_tcp(data_server()?).await?.into_split();
                let receiver = DataReceiver::Tcp(PacketReader::new(read, MAX_LAB_PACKET_BYTES));
                (DataSender::Tcp(PacketWriter::new(write)), receiver, None)
            }
        };
        Ok(OpenConnection { reader: self.reader, writer: self.writer, sender, receiver, quic: QuicHandle(quic) })
    }
}

impl DataSender {
    /// Sends one packet, unreliably.
    ///
    /// # Errors
    /// Errors if the connection is gone.
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
    /// Returns the next packet. Cancel-safe.
    ///
    /// # Errors
    /// Errors if the connection is gone.
    pub(crate) async fn receive(&mut self) -> io::Result<Bytes> {
        match self {
            Self::Quic(connection) => connection.read_datagram().await.map_err(io::Error::other),
            Self::Udp(receiver) => receiver.receive().await,
            Self::Tcp(stream) => stream.receive().await,
        }
    }
}

impl QuicHandle {
    /// Returns the number of UDP datagrams received, whatever their content; `None` on lab transports.
    pub(crate) fn datagrams_received(&self) -> Option<u64> {
        self.0.as_ref().map(|(_, connection)| connection.stats().udp_rx.datagrams)
    }

    /// Returns QUIC's estimate of the round trip; `None` on lab transports.
    pub(crate) fn round_trip(&self) -> Option<Duration> {
        self.0.as_ref().map(|(_, connection)| connection.rtt())
    }

    /// Closes the connection. Gives the server a moment to close it first.
    pub(crate) async fn close(self) {
        if let Some((_, connection)) = &self.0 {
            let _ = timeout(CLOSE_TIMEOUT, connection.closed()).await;
        }
        self.close_now().await;
    }

    /// Closes the connection, and waits a moment until the server can know.
    pub(crate) async fn close_now(self) {
        if let Some((endpoint, connection)) = self.0 {
            connection.close(0_u32.into(), b"done");
            let _ = timeout(CLOSE_TIMEOUT, endpoint.wait_idle()).await;
        }
    }
}
