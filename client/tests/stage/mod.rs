//! A scripted server for tests: one scene, computable masks, and faults on demand.

#![allow(dead_code, reason = "each test program uses a part of the stage")]

use std::{
    io::{Read as _, Write as _},
    net::{SocketAddr, TcpListener, TcpStream, UdpSocket},
    path::Path,
    sync::{Arc, Mutex},
    time::Duration,
};

use glam::{DVec3, Vec2, Vec3, Vec4};
use gnomon_client::{HeadlessOptions, Source, config::Size};
use gnomon_protocol::{
    acknowledgement::Acknowledgement,
    codec::{CodecId, EncodedFrame, Encoder, Reference},
    ids::{FrameNumber, ResumeToken, SceneDigest, SessionId},
    limits::{MAX_PACKET_BYTES, SCENE_CHUNK_BYTES},
    loss::LossFeedback,
    mask::{Mask, MaskShape},
    message::{self, ClientMessage, ServerMessage, Welcome},
    packetizer::Packetizer,
    pose::decode_pose_packet,
    references::SentMasks,
};
use gnomon_scene::{Aabb, AlphaMode, Draw, Light, LightKind, Material, Scene};

/// So small that every mask takes several packets.
const PACKET_BYTES: usize = MAX_PACKET_BYTES / 4;

/// Faults of the server.
#[derive(Debug, Clone, Default)]
pub(crate) struct Script {
    /// Frames that lose this packet, or all packets if `None`. Each entry applies once.
    pub(crate) lose: Vec<(u32, Option<usize>)>,
    /// Index of a packet that is delayed in every frame, and the delay.
    pub(crate) delayed: Option<(usize, Duration)>,
    /// Frames whose first mask has another shape.
    pub(crate) wrong_shape: Vec<u32>,
    /// Frames whose first mask is smaller than requested.
    pub(crate) smaller: Vec<u32>,
    /// Unrequested masks: before the answer to the first frame, one with the number of the second.
    pub(crate) strays: Vec<(u32, u32)>,
    /// Frames whose first request is answered together with the second.
    pub(crate) late: Vec<u32>,
    /// Frames that are first coded against a reference that the client lacks.
    pub(crate) foreign: Vec<u32>,
    /// Frame at which the server closes the session.
    pub(crate) close_at: Option<u32>,
    /// The client must not come back then.
    pub(crate) dismissed: bool,
    /// Frame at which the server drains, and the URL that it names.
    pub(crate) drain_at: Option<(u32, String)>,
    /// Stop serving after the first session.
    pub(crate) gone: bool,
    /// Sent instead of Welcome.
    pub(crate) answer: Option<ServerMessage>,
    /// Send another scene than announced.
    pub(crate) wrong_scene: bool,
}

#[derive(Debug, Default)]
struct Observed {
    resumed: Vec<Option<ResumeToken>>,
    fetches: Vec<u64>,
    bye: bool,
    /// Frames coded against a reference that the client had.
    referenced: u32,
}

pub(crate) struct Stage {
    transport: &'static str,
    address: SocketAddr,
    packed: Arc<Vec<u8>>,
    observed: Arc<Mutex<Observed>>,
}

pub(crate) fn shape() -> MaskShape {
    MaskShape::new(64, 36, 1).unwrap()
}

/// Returns the mask of a frame: noise, so that it takes several packets.
pub(crate) fn mask_for(frame: u32) -> Mask {
    let mut mask = Mask::new(shape());
    let mut state = frame.wrapping_mul(2_654_435_761) | 1;
    for y in 0..36 {
        for x in 0..64 {
            state ^= state << 13;
            state ^= state >> 17;
            state ^= state << 5;
            mask.set(0, x, y, state & 64 != 0);
        }
    }
    mask
}

fn scene() -> Scene {
    Scene {
        origin_m: DVec3::ZERO,
        bounds: Aabb { min: Vec3::new(-2.0, 0.0, -2.0), max: Vec3::new(2.0, 0.0, 2.0) },
        positions: vec![Vec3::new(-2.0, 0.0, 2.0), Vec3::new(2.0, 0.0, 2.0), Vec3::new(0.0, 0.0, -2.0)],
        normals: vec![Vec3::Y; 3],
        uvs: vec![Vec2::ZERO; 3],
        triangles: vec![[0, 1, 2]],
        draws: vec![Draw { first_triangle: 0, triangles: 1, material: 0 }],
        materials: vec![Material {
            name: "floor".into(),
            base_color: Vec4::ONE,
            alpha: AlphaMode::Opaque,
            double_sided: true,
            ..Material::default()
        }],
        lights: vec![Light {
            name: "lamp".into(),
            kind: LightKind::Point,
            position: Vec3::new(0.0, 2.0, 0.0),
            direction: Vec3::NEG_Y,
            color: Vec3::ONE,
            intensity: 20.0,
            range_m: f32::INFINITY,
        }],
        instances: 1,
        ..Scene::default()
    }
}

impl Stage {
    /// Starts a server over `lab-udp` or `lab-tcp`. Its thread ends with the process.
    pub(crate) fn start(transport: &'static str, script: Script) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        let packed = Arc::new(scene().pack().unwrap());
        let observed = Arc::new(Mutex::new(Observed::default()));
        let (for_thread, shared) = (Arc::clone(&packed), Arc::clone(&observed));
        std::thread::spawn(move || {
            for stream in listener.incoming() {
                let session = Session { stream: stream.unwrap(), packed: &for_thread, observed: Arc::clone(&shared) };
                session.serve(transport, script.clone());
                if script.gone {
                    break;
                }
            }
        });
        Self { transport, address, packed, observed }
    }

    /// Options of a run against this server: four frames of 64×36, with a separate cache.
    pub(crate) fn options(&self, folder: &Path) -> HeadlessOptions {
        let url = self.url().parse().unwrap();
        let mut options = HeadlessOptions::new(Source::Server(url));
        options.settings.size = Size { width: 64, height: 36 };
        options.settings.frames = Some(4);
        options.settings.cache_dir = Some(folder.join("cache"));
        options
    }

    pub(crate) fn url(&self) -> String {
        format!("gnomon+{}://{}", self.transport, self.address)
    }

    pub(crate) fn digest(&self) -> SceneDigest {
        SceneDigest(*blake3::hash(&self.packed).as_bytes())
    }

    /// Returns the offset of each scene fetch.
    pub(crate) fn scene_fetches(&self) -> Vec<u64> {
        self.observed.lock().unwrap().fetches.clone()
    }

    /// Returns the resume token of each Hello.
    pub(crate) fn resumed(&self) -> Vec<Option<ResumeToken>> {
        self.observed.lock().unwrap().resumed.clone()
    }

    /// Returns the frames coded against a reference that the client had.
    pub(crate) fn referenced(&self) -> u32 {
        self.observed.lock().unwrap().referenced
    }

    pub(crate) fn received_bye(&self) -> bool {
        // The client may leave before the server's thread has read its Bye.
        (0..500).any(|_| {
            std::thread::sleep(Duration::from_millis(10));
            self.observed.lock().unwrap().bye
        })
    }
}

enum Data {
    Udp(UdpSocket),
    Tcp(TcpListener),
}

struct Session<'a> {
    stream: TcpStream,
    packed: &'a [u8],
    observed: Arc<Mutex<Observed>>,
}

impl Session<'_> {
    fn serve(mut self, transport: &str, script: Script) {
        let hello = match self.next() {
            Some(ClientMessage::Hello(hello)) => hello,
            // A connection attempt that another one has overtaken.
            None => return,
            Some(other) => panic!("no Hello: {other:?}"),
        };
        self.observed.lock().unwrap().resumed.push(hello.resume);
        assert_eq!((hello.width, hello.height), (64, 36));
        if let Some(answer) = script.answer {
            return self.send(&answer);
        }
        let data = match transport {
            "lab-udp" => Data::Udp(UdpSocket::bind("127.0.0.1:0").unwrap()),
            _ => Data::Tcp(TcpListener::bind("127.0.0.1:0").unwrap()),
        };
        let port = match &data {
            Data::Udp(socket) => socket.local_addr().unwrap().port(),
            Data::Tcp(listener) => listener.local_addr().unwrap().port(),
        };
        self.send(&ServerMessage::Welcome(Welcome {
            session: SessionId(7),
            scene_digest: SceneDigest(*blake3::hash(self.packed).as_bytes()),
            scene_bytes: self.packed.len() as u64,
            lights: 1,
            backend: "stage".into(),
            data_port: Some(port),
            resume: ResumeToken([7; 16]),
            may_edit: true,
            shared_world: false,
            revision: 0,
        }));
        let mut started = false;
        let mut data = Some(data);
        while let Some(message) = self.next() {
            match message {
                ClientMessage::FetchScene { offset } => self.send_scene(offset, script.wrong_scene),
                ClientMessage::Start if !started => {
                    started = true;
                    let (control, script) = (self.stream.try_clone().unwrap(), script.clone());
                    let observed = Arc::clone(&self.observed);
                    let data = data.take().unwrap();
                    std::thread::spawn(move || send_frames(data, control, script, hello.codec, &observed));
                }
                ClientMessage::Ping(number) => self.send(&ServerMessage::Pong(number)),
                ClientMessage::Bye => self.observed.lock().unwrap().bye = true,
                other => panic!("{other:?}"),
            }
        }
    }

    fn send_scene(&mut self, offset: u64, wrong: bool) {
        self.observed.lock().unwrap().fetches.push(offset);
        let mut bytes = self.packed.to_vec();
        if wrong {
            bytes[30] ^= 1;
        }
        let first = usize::try_from(offset).unwrap();
        for (index, chunk) in bytes[first..].chunks(SCENE_CHUNK_BYTES).enumerate() {
            let offset = (first + index * SCENE_CHUNK_BYTES) as u64;
            self.send(&ServerMessage::SceneChunk { offset, bytes: chunk.to_vec() });
        }
    }

    fn next(&mut self) -> Option<ClientMessage> {
        let mut prefix = [0; 4];
        self.stream.read_exact(&mut prefix).ok()?;
        let mut bytes = vec![0; message::decode_length(prefix).unwrap()];
        self.stream.read_exact(&mut bytes).ok()?;
        Some(message::decode(&bytes).unwrap())
    }

    fn send(&mut self, message: &ServerMessage) {
        // The client may be gone.
        let _ = self.stream.write_all(&message::encode(message).unwrap());
    }
}

/// Answers every pose with its mask, in packets.
fn send_frames(data: Data, mut control: TcpStream, mut script: Script, codec: CodecId, observed: &Mutex<Observed>) {
    let mut link = Link::open(data);
    let (mut encoder, mut packetizer, mut body) =
        (Encoder::new(codec).for_packets_of(PACKET_BYTES), Packetizer::new(PACKET_BYTES), EncodedFrame::default());
    let (mut latest, mut owed, mut references) = (None, false, SentMasks::default());
    while let Some(packet) = link.receive() {
        if let Ok(acknowledgement) = Acknowledgement::decode(&packet) {
            references.acknowledge(acknowledgement);
            continue;
        }
        if LossFeedback::decode(&packet).is_ok() {
            continue;
        }
        let (sequence, FrameNumber(frame), _) = decode_pose_packet(&packet).unwrap();
        assert!(latest.is_none_or(|latest| latest < (frame, sequence)), "poses arrive in order");
        latest = Some((frame, sequence));
        if script.close_at == Some(frame) {
            let closing = ServerMessage::Closing { reason: "the curtain falls".into(), may_return: !script.dismissed };
            let _ = control.write_all(&message::encode(&closing).unwrap());
            return;
        }
        if let Some((_, alternative)) = script.drain_at.take_if(|(at, _)| *at == frame) {
            let (reason, alternative) = ("the house is sold".into(), Some(alternative.into()));
            let draining = ServerMessage::Draining { reason, deadline_ms: 60_000, alternative };
            let _ = control.write_all(&message::encode(&draining).unwrap());
        }
        if let Some(place) = script.late.iter().position(|wanted| *wanted == frame) {
            script.late.remove(place);
            owed = true;
            continue;
        }
        let wrong = script.wrong_shape.iter().position(|wanted| *wanted == frame);
        let mask = match wrong.map(|place| script.wrong_shape.remove(place)) {
            Some(_) => Mask::new(MaskShape::new(64, 40, 1).unwrap()),
            None => mask_for(frame),
        };
        let mask = match script.smaller.iter().position(|wanted| *wanted == frame) {
            Some(place) => {
                script.smaller.remove(place);
                Mask::new(MaskShape::new(32, 36, 1).unwrap())
            }
            None => mask,
        };
        for stray in script.strays.iter().filter(|(at, _)| *at == frame).map(|(_, number)| FrameNumber(*number)) {
            encoder.encode(&mask, &mut body).unwrap();
            packetizer.packets(stray, 0, &body).unwrap().for_each(|packet| link.send(&packet));
        }
        let foreign = script.foreign.iter().position(|wanted| *wanted == frame).map(|place| {
            script.foreign.remove(place);
            let mut other = Reference::new();
            encoder.encode(&mask, &mut body).unwrap();
            assert!(encoder.keep(FrameNumber(frame), &mut other));
            other
        });
        let reference = foreign.as_ref().or(references.reference());
        observed.lock().unwrap().referenced += u32::from(foreign.is_none() && reference.is_some());
        encoder.encode_for(None, reference, &mask, &mut body).unwrap();
        if foreign.is_none() {
            references.keep(&encoder, FrameNumber(frame));
        }
        let lost = script.lose.iter().position(|(wanted, _)| *wanted == frame).map(|place| script.lose.remove(place).1);
        for _ in 0..1 + u8::from(std::mem::take(&mut owed)) {
            let mut delayed = None;
            for (index, packet) in packetizer.packets(FrameNumber(frame), 0, &body).unwrap().enumerate() {
                if script.delayed.is_some_and(|(place, _)| place == index) {
                    delayed = Some(packet);
                } else if lost.is_none_or(|lost| lost.is_some_and(|lost| lost != index)) {
                    link.send(&packet);
                }
            }
            if let Some((packet, (_, delay))) = delayed.zip(script.delayed) {
                std::thread::sleep(delay);
                link.send(&packet);
            }
        }
    }
}

enum Link {
    Udp(UdpSocket, Option<SocketAddr>),
    Tcp(TcpStream),
}

impl Link {
    fn open(data: Data) -> Self {
        match data {
            Data::Udp(socket) => Self::Udp(socket, None),
            Data::Tcp(listener) => Self::Tcp(listener.accept().unwrap().0),
        }
    }

    fn receive(&mut self) -> Option<Vec<u8>> {
        match self {
            Self::Udp(socket, client) => {
                let mut buffer = [0; 2048];
                let (length, from) = socket.recv_from(&mut buffer).ok()?;
                *client = Some(from);
                Some(buffer[..length].to_vec())
            }
            Self::Tcp(stream) => {
                let mut prefix = [0; 4];
                stream.read_exact(&mut prefix).ok()?;
                let mut bytes = vec![0; u32::from_le_bytes(prefix) as usize];
                stream.read_exact(&mut bytes).ok()?;
                Some(bytes)
            }
        }
    }

    fn send(&mut self, packet: &[u8]) {
        // The client may be gone.
        let _ = match self {
            Self::Udp(socket, client) => socket.send_to(packet, client.unwrap()).map(drop),
            Self::Tcp(stream) => {
                let length = u32::try_from(packet.len()).unwrap().to_le_bytes();
                stream.write_all(&[&length, packet].concat())
            }
        };
    }
}
