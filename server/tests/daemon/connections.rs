//! Connections end, whatever their peers do and whatever a library keeps of them, and their peers are told why.

use std::{
    net::{IpAddr, Ipv4Addr},
    time::Duration,
};

use gnomon_protocol::{
    header::HEADER_BYTES,
    message::{self, ClientMessage, Hello, ServerMessage},
};
use gnomon_server::tokens::{self, Scope};
use web_transport_quinn::{Session, proto};

use super::{
    Rig,
    client::{Control, hello},
    operator::{page, value},
    peer::{Protocol, closed, connect, control, endpoint, session},
    soon,
};

const HERE: IpAddr = IpAddr::V4(Ipv4Addr::LOCALHOST);

/// Open connections, by stage.
async fn open(rig: &Rig) -> [u64; 3] {
    let page = page(rig).await;
    ["handshake", "admitted", "closing"].map(|stage| value(&page, &format!("gnomon_connections{{stage=\"{stage}\"}}")))
}

async fn all_gone(rig: &Rig) {
    soon(async {
        while open(rig).await != [0; 3] {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    })
    .await;
}

/// Waits until a session counts as one, which is a moment after its Welcome. Returns the number of handshakes.
async fn one_admitted(rig: &Rig) -> u64 {
    soon(async {
        loop {
            if let [handshakes, 1, _] = open(rig).await {
                return handshakes;
            }
        }
    })
    .await
}

async fn start(change: impl FnOnce(&mut gnomon_server::config::ServerConfig)) -> Rig {
    Rig::start(|config, _| {
        config.admin = Some("127.0.0.1:0".parse().unwrap());
        change(config);
    })
    .await
}

/// What a peer does instead of saying Hello.
#[derive(Debug, Clone, Copy)]
enum Instead {
    Nothing,
    HalfAHello,
    AnotherMessage,
    Garbage,
    Datagrams,
}

impl Instead {
    async fn act(self, session: &Session) {
        match self {
            Self::Nothing => {}
            Self::HalfAHello => {
                let whole = message::encode(&ClientMessage::Hello(hello())).unwrap();
                stream(session, &whole[..whole.len() / 2]).await;
            }
            Self::AnotherMessage => stream(session, &message::encode(&ClientMessage::Start).unwrap()).await,
            Self::Garbage => stream(session, &[0xa5; 60_000]).await,
            Self::Datagrams => {
                let size = session.max_datagram_size();
                // Until the server has had enough.
                while session.send_datagram_wait(vec![0; size].into()).await.is_ok() {}
            }
        }
    }

    const fn reason(self) -> &'static str {
        match self {
            Self::Nothing | Self::HalfAHello => "no Hello in time",
            Self::AnotherMessage => "not Hello",
            Self::Garbage => "are allowed",
            Self::Datagrams => "too many bytes before Hello",
        }
    }
}

/// Opens a stream, and leaves it open.
async fn stream(session: &Session, bytes: &[u8]) {
    let (mut send, receive) = session.open_bi().await.unwrap();
    // The server may have had enough already.
    let _ = send.write_all(bytes).await;
    std::mem::forget((send, receive));
}

#[tokio::test(flavor = "multi_thread")]
async fn who_is_not_admitted_is_told_why_and_leaves_nothing() {
    let rig = start(|config| config.handshake_timeout_ms = 300).await;
    for protocol in Protocol::BOTH {
        for instead in
            [Instead::Nothing, Instead::HalfAHello, Instead::AnotherMessage, Instead::Garbage, Instead::Datagrams]
        {
            let endpoint = endpoint(HERE, protocol);
            let mut peers = tokio::task::JoinSet::new();
            for _ in 0..8 {
                let connection = connect(&endpoint, rig.address()).await.unwrap();
                peers.spawn(async move {
                    let session = session(connection, protocol).await;
                    instead.act(&session).await;
                    closed(&session).await
                });
            }
            while let Some(told) = peers.join_next().await {
                let (code, reason) = told.unwrap();
                assert!(code == 2 && reason.contains(instead.reason()), "{protocol:?} {instead:?}: {code} {reason}");
            }
            // The peers keep their endpoint, so that the server cannot rely on them.
            all_gone(&rig).await;
        }
    }
}

/// The bytes of an HTTP/3 connection up to the end of its CONNECT request, on a control and a request stream.
async fn web_streams(connection: &quinn::Connection) -> (quinn::SendStream, quinn::SendStream, quinn::RecvStream) {
    let mut settings = proto::Settings::default();
    settings.enable_webtransport(1);
    let mut uni = connection.open_uni().await.unwrap();
    settings.write(&mut uni).await.unwrap();
    let (mut send, receive) = connection.open_bi().await.unwrap();
    let url = url::Url::parse("https://localhost/").unwrap();
    proto::ConnectRequest::new(url).write(&mut send).await.unwrap();
    (uni, send, receive)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_web_peer_that_breaks_http_leaves_nothing() {
    let rig = start(|config| config.handshake_timeout_ms = 300).await;
    let endpoint = endpoint(HERE, Protocol::Web);
    // No request, garbage for settings, garbage for a request, and capsules that nobody knows.
    for what in ["silence", "settings", "request", "capsules"] {
        let mut held = Vec::new();
        for _ in 0..8 {
            let connection = connect(&endpoint, rig.address()).await.unwrap();
            match what {
                "silence" => {}
                "settings" => {
                    let mut uni = connection.open_uni().await.unwrap();
                    let _ = uni.write_all(&[0; 5000]).await;
                    std::mem::forget(uni);
                }
                "request" => {
                    let mut settings = proto::Settings::default();
                    settings.enable_webtransport(1);
                    let mut uni = connection.open_uni().await.unwrap();
                    settings.write(&mut uni).await.unwrap();
                    let (mut send, receive) = connection.open_bi().await.unwrap();
                    let _ = send.write_all(&[0xff; 5000]).await;
                    std::mem::forget((uni, send, receive));
                }
                _ => {
                    let (uni, mut send, receive) = web_streams(&connection).await;
                    // DATA frames of one unknown, empty capsule each.
                    let _ = send.write_all(&[0, 2, 0x21, 0].repeat(10_000)).await;
                    std::mem::forget((uni, send, receive));
                }
            }
            held.push(connection);
        }
        for connection in held {
            let error = soon(connection.closed()).await;
            assert!(matches!(error, quinn::ConnectionError::ApplicationClosed(_)), "{what}: {error}");
        }
        all_gone(&rig).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn sessions_close_with_a_code_and_a_reason_in_words() {
    let (good, entry) = tokens::make("ours", None, &[Scope::Session], false).unwrap();
    for protocol in Protocol::BOTH {
        let rig = Rig::start(|config, folder| {
            let tokens = folder.join("tokens");
            std::fs::write(&tokens, &entry).unwrap();
            config.token_file = Some(tokens);
            config.admin = Some("127.0.0.1:0".parse().unwrap());
        })
        .await;
        let endpoint = endpoint(HERE, protocol);
        let enter = async || session(connect(&endpoint, rig.address()).await.unwrap(), protocol).await;

        let refused = enter().await;
        let mut its_control = control(&refused).await;
        its_control.send(&ClientMessage::Hello(hello())).await;
        let (code, reason) = closed(&refused).await;
        assert!(code == 1 && reason.contains("token"), "{protocol:?}: {code} {reason}");

        let admitted = async || {
            let session = enter().await;
            let mut control = control(&session).await;
            control.welcome(Hello { token: Some(good.clone().into()), ..hello() }).await;
            (session, control)
        };
        let (violating, mut its_control) = admitted().await;
        its_control.send(&ClientMessage::FetchScene { offset: u64::MAX }).await;
        let (code, reason) = closed(&violating).await;
        assert!(code == 2 && reason.contains("does not exist"), "{protocol:?}: {code} {reason}");

        let (staying, mut its_control) = admitted().await;
        one_admitted(&rig).await;
        let Rig { server, folder } = rig;
        let stopping = tokio::spawn(server.shutdown());
        while !matches!(its_control.receive().await, Some(ServerMessage::Closing { .. }) | None) {}
        assert_eq!(closed(&staying).await, (0, "the server stops".to_owned()), "{protocol:?}");
        soon(stopping).await.unwrap();
        drop(folder);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_session_that_floods_its_connection_is_closed() {
    let rig = start(|_| {}).await;
    for protocol in Protocol::BOTH {
        let endpoint = endpoint(HERE, protocol);
        let connection = connect(&endpoint, rig.address()).await.unwrap();
        match protocol {
            Protocol::Native => {
                let session = session(connection.clone(), protocol).await;
                let mut control = control(&session).await;
                control.welcome(hello()).await;
                // The server reads no datagram before Start.
                while session.send_datagram_wait(vec![0; 1000].into()).await.is_ok() {}
                assert_eq!(closed(&session).await, (2, "too many bytes per second".to_owned()));
            }
            Protocol::Web => {
                let (_uni, mut request, _answer) = web_streams(&connection).await;
                let (mut send, receive) = connection.open_bi().await.unwrap();
                send.write_all(&[0x40, 0x41, 0]).await.unwrap();
                let mut control = Control::new(receive, send);
                control.welcome(hello()).await;
                let capsules = [0, 2, 0x21, 0].repeat(16 * 1024);
                while request.write_all(&capsules).await.is_ok() {}
                let error = soon(connection.closed()).await;
                assert!(matches!(error, quinn::ConnectionError::ApplicationClosed(_)), "{error}");
            }
        }
        rig.sessions(0).await;
        all_gone(&rig).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_flood_of_handshakes_evicts_itself() {
    // Only an eviction can make room.
    let rig = start(|config| config.handshake_timeout_ms = 60_000).await;
    for protocol in Protocol::BOTH {
        let mut flood = Vec::new();
        for source in 2..12 {
            let endpoint = endpoint(Ipv4Addr::new(127, 0, 0, source).into(), protocol);
            for _ in 0..60 {
                let connection = connect(&endpoint, rig.address()).await.unwrap();
                flood.push((endpoint.clone(), connection));
            }
        }
        let mine = endpoint(HERE, protocol);
        let session = session(connect(&mine, rig.address()).await.unwrap(), protocol).await;
        let mut its_control = control(&session).await;
        its_control.welcome(hello()).await;
        let handshakes = one_admitted(&rig).await;
        assert!(handshakes <= 512, "{protocol:?}: {handshakes}");
        let gone = flood.iter().filter_map(|(_, connection)| connection.close_reason()).collect::<Vec<_>>();
        assert!(gone.len() >= 600 - 512, "{}", gone.len());
        for error in gone {
            let quinn::ConnectionError::ApplicationClosed(close) = error else { panic!("{error}") };
            let reason = String::from_utf8_lossy(&close.reason).into_owned();
            assert!(reason.contains("too many connections are being made"), "{reason}");
        }
        let page = page(&rig).await;
        assert!(value(&page, "gnomon_refusals_total{cause=\"handshakes\"}") >= 600 - 512, "{page}");
        session.close(0, b"");
        for (endpoint, _) in flood {
            endpoint.close(0_u32.into(), b"");
        }
        all_gone(&rig).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn without_browsers_h3_is_not_offered() {
    let rig = start(|config| config.browsers = false).await;
    let error = connect(&endpoint(HERE, Protocol::Web), rig.address()).await.unwrap_err();
    assert!(error.to_string().contains("known protocol"), "{error}");
    let native = endpoint(HERE, Protocol::Native);
    let session = session(connect(&native, rig.address()).await.unwrap(), Protocol::Native).await;
    control(&session).await.welcome(hello()).await;
    assert!(session.max_datagram_size() > HEADER_BYTES);
}
