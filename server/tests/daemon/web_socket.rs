//! Sessions over WebSockets, as of a browser whose network drops UDP.

use std::net::SocketAddr;

use futures_util::{SinkExt as _, StreamExt as _};
use gnomon_protocol::message::{self, ClientMessage, Hello, ServerMessage, Welcome};
use tokio::net::TcpStream;
use tokio_tungstenite::{
    WebSocketStream, client_async,
    tungstenite::{Error, Message, client::IntoClientRequest as _},
};

use super::{
    Rig,
    client::{Frames, hello, pose_packet},
    soon,
};

const CONTROL: u8 = 0;
const DATA: u8 = 1;

struct Page {
    socket: WebSocketStream<TcpStream>,
    /// Bytes of the control stream that are no whole message yet.
    control: Vec<u8>,
}

/// What a page hears.
#[derive(Debug)]
enum Heard {
    Said(ServerMessage),
    Frame(Vec<u8>),
    /// With the socket's code and reason, if it was closed with some.
    End(Option<(u16, String)>),
}

impl Page {
    async fn open(web: SocketAddr, origin: Option<&str>) -> Result<Self, Error> {
        let mut request = format!("ws://{web}/session").into_client_request().unwrap();
        if let Some(origin) = origin {
            request.headers_mut().insert("origin", origin.parse().unwrap());
        }
        let stream = TcpStream::connect(web).await.unwrap();
        let (socket, _) = soon(client_async(request, stream)).await?;
        Ok(Self { socket, control: Vec::new() })
    }

    async fn send(&mut self, kind: u8, bytes: &[u8]) {
        self.socket.send(Message::binary([&[kind], bytes].concat())).await.unwrap();
    }

    async fn say(&mut self, message: &ClientMessage) {
        self.send(CONTROL, &message::encode(message).unwrap()).await;
    }

    async fn hear(&mut self) -> Heard {
        loop {
            if let Some((prefix, rest)) = self.control.split_first_chunk::<4>() {
                let length = message::decode_length(*prefix).unwrap();
                if let Some(content) = rest.get(..length) {
                    let said = message::decode(content).unwrap();
                    self.control.drain(..4 + length);
                    return Heard::Said(said);
                }
            }
            match soon(self.socket.next()).await {
                Some(Ok(Message::Binary(bytes))) if bytes[0] == CONTROL => self.control.extend_from_slice(&bytes[1..]),
                Some(Ok(Message::Binary(bytes))) => {
                    assert_eq!(bytes[0], DATA);
                    return Heard::Frame(bytes[1..].to_vec());
                }
                Some(Ok(Message::Close(frame))) => {
                    return Heard::End(frame.map(|frame| (frame.code.into(), frame.reason.to_string())));
                }
                Some(Err(_)) | None => return Heard::End(None),
                Some(Ok(_)) => {}
            }
        }
    }

    async fn welcome(&mut self, hello: Hello) -> Welcome {
        self.say(&ClientMessage::Hello(hello)).await;
        match self.hear().await {
            Heard::Said(ServerMessage::Welcome(welcome)) => welcome,
            other => panic!("no welcome: {other:?}"),
        }
    }
}

async fn with_web(origins: Option<&str>) -> (Rig, SocketAddr) {
    let rig = Rig::start(|config, _| {
        config.web = Some("127.0.0.1:0".parse().unwrap());
        config.origins = origins.map(|origins| origins.parse().unwrap());
    })
    .await;
    let web = rig.server.web_addr().unwrap();
    (rig, web)
}

#[tokio::test(flavor = "multi_thread")]
async fn scene_and_frames_come_through_a_web_socket() {
    let (rig, web) = with_web(None).await;
    let mut page = Page::open(web, None).await.unwrap();
    let welcome = page.welcome(hello()).await;
    page.say(&ClientMessage::FetchScene { offset: 0 }).await;
    let mut packed = Vec::new();
    while (packed.len() as u64) < welcome.scene_bytes {
        match page.hear().await {
            Heard::Said(ServerMessage::SceneChunk { bytes, .. }) => packed.extend_from_slice(&bytes),
            other => panic!("no chunk: {other:?}"),
        }
    }
    assert_eq!(blake3::hash(&packed).as_bytes(), &welcome.scene_digest.0);
    page.say(&ClientMessage::Start).await;
    page.say(&ClientMessage::Ping(7)).await;
    let (mut frames, mut masks, mut pongs, mut sequence) = (Frames::new(), 0, 0, 0);
    // Nothing is lost on the way, so that each pose that is asked for again and again is answered at last.
    while masks < 5 || pongs == 0 {
        page.send(DATA, &pose_packet(sequence, sequence)).await;
        sequence += 1;
        match page.hear().await {
            Heard::Frame(mut packets) => {
                let mut completed = 0;
                while let Some((length, rest)) = packets.split_first_chunk::<2>() {
                    let (packet, rest) = rest.split_at(u16::from_le_bytes(*length).into());
                    completed += u32::from(frames.push(packet).is_some());
                    packets = rest.to_vec();
                }
                assert_eq!(completed, 1, "a message is a frame");
                masks += 1;
            }
            Heard::Said(ServerMessage::Pong(7)) => pongs += 1,
            other => panic!("{other:?}"),
        }
    }
    rig.sessions(1).await;
    page.say(&ClientMessage::Bye).await;
    while !matches!(page.hear().await, Heard::End(_)) {}
    rig.sessions(0).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn only_pages_of_listed_origins_open_a_web_socket() {
    let (_rig, web) = with_web(Some("https://a.example")).await;
    for origin in [None, Some("null"), Some("https://evil.example")] {
        let opened = Page::open(web, origin).await.map(drop);
        assert!(matches!(&opened, Err(Error::Http(answer)) if answer.status() == 403), "{origin:?}: {opened:?}");
    }
    Page::open(web, Some("https://a.example")).await.unwrap().welcome(hello()).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_page_that_goes_or_babbles_ends_its_session_only() {
    let (rig, web) = with_web(None).await;
    let mut honest = Page::open(web, None).await.unwrap();
    honest.welcome(hello()).await;
    let mut gone = Page::open(web, None).await.unwrap();
    gone.welcome(hello()).await;
    rig.sessions(2).await;
    drop(gone);
    rig.sessions(1).await;
    for message in [Message::text("hello"), Message::binary(vec![9]), Message::binary(vec![0xff; 100_000])] {
        let mut babbler = Page::open(web, None).await.unwrap();
        babbler.welcome(hello()).await;
        let _ = babbler.socket.send(message).await;
        while !matches!(babbler.hear().await, Heard::End(_)) {}
    }
    let mut silent = Page::open(web, None).await.unwrap();
    silent.send(CONTROL, &[0xff; 64]).await;
    while !matches!(silent.hear().await, Heard::End(_)) {}
    rig.sessions(1).await;
    rig.server.shutdown().await;
    let mut last = honest.hear().await;
    while let Heard::Said(ServerMessage::Draining { .. } | ServerMessage::Closing { .. }) = last {
        last = honest.hear().await;
    }
    assert!(matches!(&last, Heard::End(Some((4000, _)))), "{last:?}");
}

/// A page is told as by WebTransport, whose code for this is 4.
#[tokio::test(flavor = "multi_thread")]
async fn a_session_that_the_operator_ends_closes_its_socket_with_the_code_and_the_reason() {
    let (rig, web) = with_web(None).await;
    let mut page = Page::open(web, None).await.unwrap();
    let welcome = page.welcome(hello()).await;
    assert!(rig.server.end_session(welcome.session.0));
    let Heard::Said(ServerMessage::Closing { reason, .. }) = page.hear().await else { panic!("no goodbye") };
    let Heard::End(Some((code, said))) = page.hear().await else { panic!("no code") };
    assert_eq!((code, said.as_str()), (4004, reason.unescaped()));
}
