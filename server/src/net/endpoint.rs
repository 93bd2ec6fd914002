//! Accepts peers: a QUIC endpoint for native clients and browsers, or a loopback listener for lab transports.

use std::{
    io,
    net::{SocketAddr, UdpSocket},
    sync::Arc,
};

use gnomon_protocol::{limits::MAX_FRAME_BYTES, text::Escaped};
use gnomon_transport::{
    quic::{self, ALPN},
    socket::bind_udp,
};
use quinn::crypto::rustls::QuicServerConfig;
use rustls::crypto::CryptoProvider;
use socket2::{Domain, Protocol, Socket, Type};
use thiserror::Error;
use tokio::net::TcpListener;
use web_transport_quinn::Session;

use super::{
    alpn::is_web,
    certificate::{ALPN_WEB, Certificates},
    connections::{Guard, Place, Tenure, TenureRuntime, accept_for},
    link::{DataLink, LabTcpData, LabUdpData, Link, QuicData, SocketArrival},
    page::{self, PageError},
    socket::{CountingSocket, SocketCounts},
};
use crate::{
    clock::SteadyClock,
    config::{ServerConfig, Transport},
    limits,
    origins::Origins,
};

/// quinn's datagram send buffer. It never fills, since the frame gate closes at 1.6 frames of any size.
const DATAGRAM_SEND_BUFFER_BYTES: usize = 2 * MAX_FRAME_BYTES;

#[derive(Debug, Error)]
pub enum ListenError {
    #[error("{0} is taken: stop the other program, or pass another --listen ADDR:PORT")]
    Taken(SocketAddr),
    #[error("cannot listen on {address}: {reason}")]
    Socket { address: SocketAddr, reason: io::Error },
    #[error("cannot set up TLS: {0}")]
    Tls(String),
}

/// A bound socket that accepts nothing yet. Binding comes before loading the scene, so that a taken port fails early.
pub(crate) enum Bound {
    Quic(UdpSocket),
    Lab(std::net::TcpListener),
}

pub(crate) enum Endpoint {
    Quic { endpoint: quinn::Endpoint, counts: Arc<SocketCounts> },
    Lab { listener: TcpListener, transport: Transport },
}

/// Binds the configured address. Errors if the address is taken or unusable.
pub(crate) fn bind(config: &ServerConfig) -> Result<Bound, ListenError> {
    let address = config.listen;
    let attempt = || {
        if config.transport == Transport::Quic {
            return Ok(Bound::Quic(bind_udp(address, quic::SOCKET_BUFFER_BYTES)?));
        }
        let socket = Socket::new(Domain::for_address(address), Type::STREAM, Some(Protocol::TCP))?;
        if address.is_ipv6() {
            // `[::]` serves IPv4, too, on every system.
            socket.set_only_v6(false)?;
        }
        socket.set_nonblocking(true)?;
        // A restarted lab server must not wait for the old connections' TIME_WAIT.
        #[cfg(unix)]
        socket.set_reuse_address(true)?;
        socket.bind(&address.into())?;
        socket.listen(128)?;
        Ok(Bound::Lab(socket.into()))
    };
    attempt().map_err(|reason: io::Error| match reason.kind() {
        io::ErrorKind::AddrInUse => ListenError::Taken(address),
        _ => ListenError::Socket { address, reason },
    })
}

impl Bound {
    /// Errors if the system does not know the address.
    pub(crate) fn local_addr(&self) -> io::Result<SocketAddr> {
        match self {
            Self::Quic(socket) => socket.local_addr(),
            Self::Lab(listener) => listener.local_addr(),
        }
    }

    /// Starts to receive packets, counting them in `counts`. Errors if TLS or the runtime refuses.
    pub(crate) fn open(
        self,
        config: &ServerConfig,
        certificates: Option<Arc<Certificates>>,
        provider: &Arc<CryptoProvider>,
        counts: &Arc<SocketCounts>,
    ) -> Result<Endpoint, ListenError> {
        let socket_error = |reason| ListenError::Socket { address: config.listen, reason };
        match (self, certificates) {
            (Self::Lab(listener), _) => {
                let listener = TcpListener::from_std(listener).map_err(socket_error)?;
                Ok(Endpoint::Lab { listener, transport: config.transport })
            }
            (Self::Quic(_), None) => Err(ListenError::Tls("no certificate".to_owned())),
            (Self::Quic(socket), Some(certificates)) => {
                let server = quic_config(config, certificates, provider)?;
                let runtime = Arc::new(TenureRuntime);
                let counts = Arc::clone(counts);
                let socket = quinn::Runtime::wrap_udp_socket(&*runtime, socket).map_err(socket_error)?;
                let socket = Arc::new(CountingSocket::new(socket, Arc::clone(&counts)));
                quinn::Endpoint::new_with_abstract_socket(
                    quinn::EndpointConfig::default(),
                    Some(server),
                    socket,
                    runtime,
                )
                .map(|endpoint| Endpoint::Quic { endpoint, counts })
                .map_err(socket_error)
            }
        }
    }
}

fn quic_config(
    config: &ServerConfig,
    certificates: Arc<Certificates>,
    provider: &Arc<CryptoProvider>,
) -> Result<quinn::ServerConfig, ListenError> {
    let tls_error = |error: &dyn std::fmt::Display| ListenError::Tls(error.to_string());
    let mut tls = rustls::ServerConfig::builder_with_provider(Arc::clone(provider))
        .with_protocol_versions(&[&rustls::version::TLS13])
        .map_err(|error| tls_error(&error))?
        .with_no_client_auth()
        .with_cert_resolver(certificates);
    tls.alpn_protocols = vec![ALPN.to_vec()];
    if config.browsers {
        tls.alpn_protocols.push(ALPN_WEB.to_vec());
    }
    let crypto = QuicServerConfig::try_from(tls).map_err(|error| tls_error(&error))?;
    let mut server = quinn::ServerConfig::with_crypto(Arc::new(crypto));
    server
        .max_incoming(limits::MAX_HANDSHAKES)
        .incoming_buffer_size(limits::INCOMING_BUFFER_BYTES)
        // Setting the clock must not affect the age of Retry tokens.
        .time_source(Arc::new(SteadyClock::new()))
        .incoming_buffer_size_total(limits::INCOMING_BUFFER_TOTAL_BYTES)
        .transport_config(Arc::new(transport_config(config).map_err(|error| tls_error(&error))?));
    Ok(server)
}

fn transport_config(config: &ServerConfig) -> Result<quinn::TransportConfig, quinn::VarIntBoundsExceeded> {
    let idle_timeout = config.idle_timeout();
    // Keep-alives keep a client whose camera stands still; a lost client does not answer them.
    let mut transport = quic::transport_config(idle_timeout, idle_timeout / 3, config.initial_window_bytes)?;
    transport
        .datagram_receive_buffer_size(Some(limits::DATAGRAM_RECEIVE_BUFFER_BYTES))
        .datagram_send_buffer_size(DATAGRAM_SEND_BUFFER_BYTES)
        .stream_receive_window(limits::STREAM_RECEIVE_WINDOW_BYTES.into())
        // Raised on admission.
        .receive_window(limits::STREAM_RECEIVE_WINDOW_BYTES.into())
        .send_window(limits::SEND_WINDOW_BYTES)
        .max_concurrent_bidi_streams(limits::MAX_BIDI_STREAMS.into())
        .max_concurrent_uni_streams(limits::MAX_UNI_STREAMS.into());
    Ok(transport)
}

/// A peer whose first packet has arrived.
pub(crate) enum Arrival {
    Quic(Box<quinn::Incoming>),
    Lab {
        stream: tokio::net::TcpStream,
        peer: SocketAddr,
        transport: Transport,
    },
    /// Through the web address.
    Socket(Box<SocketArrival>),
}

#[derive(Debug, Error)]
pub(crate) enum ArrivalError {
    #[error("QUIC handshake: {}", Escaped(.0))]
    Quic(#[from] quinn::ConnectionError),
    #[error(transparent)]
    Page(#[from] PageError),
    #[error("control stream: {}", Escaped(.0))]
    Stream(#[from] web_transport_quinn::SessionError),
    #[error("socket: {0}")]
    Socket(#[from] io::Error),
    #[error("the peer supports no datagrams")]
    NoDatagrams,
}

impl Endpoint {
    /// Returns the next peer, or `None` once the endpoint is closed.
    pub(crate) async fn accept(&self) -> Option<Arrival> {
        loop {
            match self {
                Self::Quic { endpoint, counts } => {
                    let incoming = endpoint.accept().await?;
                    if incoming.remote_address_validated() || is_link_local(incoming.remote_address()) {
                        return Some(Arrival::Quic(Box::new(incoming)));
                    }
                    counts.count_retry();
                    // Always retry: a spoofed first packet of 1200 bytes would send 3738 bytes of certificate to a
                    // victim. A Retry has 108 bytes, and costs an honest client one round trip.
                    if let Err(error) = incoming.retry() {
                        error.into_incoming().ignore();
                    }
                }
                Self::Lab { listener, transport } => match listener.accept().await {
                    Ok((stream, peer)) => return Some(Arrival::Lab { stream, peer, transport: *transport }),
                    Err(error) => {
                        // Usually out of file descriptors, until a session ends.
                        tracing::warn!(%error, "cannot accept a connection");
                        tokio::time::sleep(std::time::Duration::from_millis(100)).await;
                    }
                },
            }
        }
    }

    /// Closes every connection, and waits up to [`limits::LINGER`] for the peers' acknowledgements.
    pub(crate) async fn close(&self) {
        if let Self::Quic { endpoint, .. } = self {
            endpoint.close(0u32.into(), b"the server stops");
            // Other peers notice by their idle timeout.
            let _ = tokio::time::timeout(limits::LINGER, endpoint.wait_idle()).await;
        }
    }
}

/// A Retry's token loses the zone of such an address, so its client could never come back. Who forges one is on this
/// very link, where a flood needs no server.
fn is_link_local(peer: SocketAddr) -> bool {
    matches!(peer, SocketAddr::V6(address) if address.ip().is_unicast_link_local())
}

impl Arrival {
    pub(crate) fn peer(&self) -> SocketAddr {
        match self {
            Self::Quic(incoming) => incoming.remote_address(),
            Self::Lab { peer, .. } => *peer,
            Self::Socket(arrival) => arrival.peer,
        }
    }

    /// Refuses the peer without a handshake.
    pub(crate) fn refuse(self) {
        match self {
            Self::Quic(incoming) => incoming.refuse(),
            Self::Lab { stream, .. } => drop(stream),
            Self::Socket(arrival) => drop(arrival),
        }
    }

    /// Begins the transport's handshake. Errors if the peer is gone already.
    pub(crate) fn open(self, (place, tenure): (Place, Tenure)) -> Result<(Guard, Opening), ArrivalError> {
        let peer = self.peer();
        match self {
            Self::Quic(incoming) => {
                let connecting = accept_for(tenure, || incoming.accept())?;
                // A server may have a handle on a connection before the handshake is complete, to close it. Nothing is
                // sent before that.
                let (connection, established) =
                    connecting.into_0rtt().map_err(|_| quinn::ConnectionError::LocallyClosed)?;
                let guard = Guard::quic(connection.clone(), place);
                Ok((guard, Opening::Quic { connection, established, peer }))
            }
            Self::Lab { stream, transport, .. } => {
                Ok((Guard::lab(place, tenure), Opening::Lab { stream, peer, transport }))
            }
            Self::Socket(arrival) => Ok((Guard::lab(place, tenure), Opening::Socket(arrival))),
        }
    }
}

/// A peer whose handshake is under way.
pub(crate) enum Opening {
    Quic { connection: quinn::Connection, established: quinn::ZeroRttAccepted, peer: SocketAddr },
    Lab { stream: tokio::net::TcpStream, peer: SocketAddr, transport: Transport },
    Socket(Box<SocketArrival>),
}

impl Opening {
    /// Completes the transport's handshake, and waits for the client's control stream. Errors if the peer disconnects,
    /// speaks another protocol, or is a page of another origin than these. `guard` belongs to the same peer.
    pub(crate) async fn into_link(self, guard: &Guard, origins: Option<&Origins>) -> Result<Link, ArrivalError> {
        match self {
            Self::Quic { connection, established, peer } => {
                established.await;
                if let Some(error) = connection.close_reason() {
                    return Err(error.into());
                }
                let (session, carrier) = if is_web(&connection) {
                    (page::admit(connection, origins, limits::LINGER).await?, "webtransport")
                } else {
                    (Session::raw(connection), "quic")
                };
                let data = QuicData::new(session, DATAGRAM_SEND_BUFFER_BYTES);
                guard.carry(&data);
                if data.max_datagram_bytes() < gnomon_protocol::header::HEADER_BYTES * 2 {
                    return Err(ArrivalError::NoDatagrams);
                }
                let (send, receive) = data.accept_bi().await?;
                Ok(Link::new(carrier, peer, receive, send, DataLink::Quic(data)))
            }
            Self::Lab { stream, peer, transport } => {
                stream.set_nodelay(true)?;
                let ip = stream.local_addr()?.ip();
                let data = if transport == Transport::LabTcp {
                    DataLink::LabTcp(LabTcpData::bind(ip).await?)
                } else {
                    DataLink::LabUdp(LabUdpData::bind(ip)?)
                };
                let (receive, send) = stream.into_split();
                let carrier = if transport == Transport::LabTcp { "lab-tcp" } else { "lab-udp" };
                Ok(Link::new(carrier, peer, receive, send, data))
            }
            Self::Socket(arrival) => {
                let SocketArrival { peer, control, data } = *arrival;
                let (receive, send) = tokio::io::split(control);
                Ok(Link::new("websocket", peer, receive, send, DataLink::Socket(data)))
            }
        }
    }
}
