//! A minimal client: speaks the protocol, without prediction or rendering.

use std::{net::SocketAddr, path::Path, sync::Arc};

use gnomon_protocol::{
    PROTOCOL_VERSION,
    codec::{CodecId, Decoder},
    ids::FrameNumber,
    mask::{Mask, MaskShape},
    message::{self, ClientMessage, Hello, ServerMessage, Welcome},
    pose::{Pose, encode_pose_packet},
    reassembler::{Policy, Progress, Reassembler},
};
use quinn::crypto::rustls::QuicClientConfig;
use rustls::pki_types::{CertificateDer, pem::PemObject as _};
use tokio::io::{AsyncRead, AsyncReadExt as _, AsyncWrite, AsyncWriteExt as _};

use super::{LIGHTS, soon};

pub(crate) const WIDTH: u32 = 96;
pub(crate) const HEIGHT: u32 = 64;

pub(crate) fn hello() -> Hello {
    Hello {
        version: PROTOCOL_VERSION,
        token: None,
        client: "test".into(),
        width: WIDTH,
        height: HEIGHT,
        codec: CodecId::PlanesLz4,
        rate_hz: 0,
        wrong_ppm: 0,
        resume: None,
    }
}

/// A pose above the floor, looking down at it.
pub(crate) fn pose() -> Pose {
    let half = std::f64::consts::FRAC_1_SQRT_2;
    Pose {
        position_m: [0.0, 2.5, 0.0],
        orientation: [-half, 0.0, 0.0, half],
        yfov_rad: 1.2,
        scene_time_s: 0.0,
        client_time_ms: 0,
        mask_px: [WIDTH, HEIGHT].map(|side| u16::try_from(side).unwrap()),
        look_ahead_ms: 0,
        revision: 0,
    }
}

pub(crate) fn pose_packet(sequence: u32, frame: u32) -> Vec<u8> {
    encode_pose_packet(sequence, FrameNumber(frame), &pose()).to_vec()
}

pub(crate) struct Control {
    read: Box<dyn AsyncRead + Send + Unpin>,
    write: Box<dyn AsyncWrite + Send + Unpin>,
    /// Bytes received from the server.
    pub(crate) received_bytes: usize,
}

impl Control {
    pub(crate) fn new(
        read: impl AsyncRead + Send + Unpin + 'static,
        write: impl AsyncWrite + Send + Unpin + 'static,
    ) -> Self {
        Self { read: Box::new(read), write: Box::new(write), received_bytes: 0 }
    }

    pub(crate) async fn send(&mut self, message: &ClientMessage) {
        self.send_bytes(&message::encode(message).unwrap()).await;
    }

    pub(crate) async fn send_bytes(&mut self, bytes: &[u8]) {
        self.write.write_all(bytes).await.unwrap();
    }

    /// The server's next message; `None` once the server has ended the stream.
    pub(crate) async fn receive(&mut self) -> Option<ServerMessage> {
        soon(async {
            let mut prefix = [0; 4];
            self.read.read_exact(&mut prefix).await.ok()?;
            let mut bytes = vec![0; message::decode_length(prefix).unwrap()];
            self.read.read_exact(&mut bytes).await.ok()?;
            self.received_bytes += 4 + bytes.len();
            Some(message::decode(&bytes).unwrap())
        })
        .await
    }

    pub(crate) async fn welcome(&mut self, hello: Hello) -> Welcome {
        self.send(&ClientMessage::Hello(hello)).await;
        match self.receive().await {
            Some(ServerMessage::Welcome(welcome)) => welcome,
            other => panic!("no welcome: {other:?}"),
        }
    }

    /// Fetches the scene from byte `offset` on.
    pub(crate) async fn fetch(&mut self, welcome: &Welcome, offset: u64) -> Vec<u8> {
        self.send(&ClientMessage::FetchScene { offset }).await;
        let mut packed = Vec::new();
        while offset + (packed.len() as u64) < welcome.scene_bytes {
            match self.receive().await {
                Some(ServerMessage::SceneChunk { offset: at, bytes }) => {
                    assert_eq!(at, offset + packed.len() as u64);
                    packed.extend_from_slice(&bytes);
                }
                other => panic!("no chunk: {other:?}"),
            }
        }
        packed
    }
}

pub(crate) struct Native {
    pub(crate) endpoint: quinn::Endpoint,
    pub(crate) connection: quinn::Connection,
    pub(crate) control: Control,
    pub(crate) pose: Pose,
}

impl Native {
    pub(crate) async fn connect(address: SocketAddr, folder: &Path) -> Self {
        let socket = socket2::Socket::new(socket2::Domain::IPV4, socket2::Type::DGRAM, None).unwrap();
        socket.set_recv_buffer_size(4 << 20).unwrap();
        socket.bind(&SocketAddr::from(([127, 0, 0, 1], 0)).into()).unwrap();
        let runtime = Arc::new(quinn::TokioRuntime);
        let endpoint = quinn::Endpoint::new(quinn::EndpointConfig::default(), None, socket.into(), runtime).unwrap();
        let config = client_config(&certificate(folder), b"gnomon/1");
        let connecting = endpoint.connect_with(config, address, "localhost").unwrap();
        let connection = soon(connecting).await.unwrap();
        let (send, receive) = connection.open_bi().await.unwrap();
        Self { endpoint, connection, control: Control::new(receive, send), pose: pose() }
    }

    /// Connects, and sends Start without fetching the scene.
    pub(crate) async fn started(address: SocketAddr, folder: &Path) -> Self {
        let mut client = Self::connect(address, folder).await;
        client.control.welcome(hello()).await;
        client.control.send(&ClientMessage::Start).await;
        client
    }

    pub(crate) fn send_pose(&self, sequence: u32, frame: u32) {
        let packet = encode_pose_packet(sequence, FrameNumber(frame), &self.pose);
        self.connection.send_datagram(packet.to_vec().into()).unwrap();
    }

    /// Sends the pose repeatedly until its frame arrives, since the server may not have read Start yet.
    pub(crate) async fn frame(&self, frames: &mut Frames, number: u32) -> Mask {
        let mut sequence = number * 1000;
        soon(async {
            loop {
                self.send_pose(sequence, number);
                sequence += 1;
                let patience = std::time::Duration::from_millis(500);
                let arrived = tokio::time::timeout(patience, async {
                    loop {
                        let datagram = self.connection.read_datagram().await.unwrap();
                        if let Some((frame, mask)) = frames.push(&datagram)
                            && frame == number
                        {
                            return mask;
                        }
                    }
                });
                if let Ok(mask) = arrived.await {
                    return mask;
                }
            }
        })
        .await
    }
}

/// Reassembles and decodes masks.
pub(crate) struct Frames {
    reassembler: Reassembler,
    decoder: Decoder,
    /// Timestamp of the latest frame's header, in ms.
    pub(crate) timestamp_ms: u32,
}

impl Frames {
    pub(crate) fn new() -> Self {
        Self { reassembler: Reassembler::new(Policy::WholeFrame), decoder: Decoder::new(), timestamp_ms: u32::MAX }
    }

    /// Returns the frame that this packet completes.
    pub(crate) fn push(&mut self, packet: &[u8]) -> Option<(u32, Mask)> {
        if self.reassembler.push(packet).unwrap() != Progress::Complete {
            return None;
        }
        let frame = self.reassembler.frame().unwrap();
        let mut mask = Mask::new(MaskShape::new(WIDTH, HEIGHT, LIGHTS).unwrap());
        self.timestamp_ms = frame.timestamp_ms;
        assert_eq!(self.decoder.decode(frame.body, &mut mask).unwrap(), CodecId::PlanesLz4);
        Some((frame.frame.0, mask))
    }
}

/// The server's permanent certificate.
pub(crate) fn certificate(folder: &Path) -> CertificateDer<'static> {
    CertificateDer::from_pem_file(folder.join("cert/identity.pem")).unwrap()
}

pub(crate) fn client_config(certificate: &CertificateDer<'static>, alpn: &[u8]) -> quinn::ClientConfig {
    let mut roots = rustls::RootCertStore::empty();
    roots.add(certificate.clone()).unwrap();
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let mut tls = rustls::ClientConfig::builder_with_provider(provider)
        .with_protocol_versions(&[&rustls::version::TLS13])
        .unwrap()
        .with_root_certificates(roots)
        .with_no_client_auth();
    tls.alpn_protocols = vec![alpn.to_vec()];
    quinn::ClientConfig::new(Arc::new(QuicClientConfig::try_from(tls).unwrap()))
}
