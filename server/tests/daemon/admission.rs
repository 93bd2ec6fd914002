//! Refusals. A refused client gets no part of the scene.

use gnomon_protocol::{
    PROTOCOL_VERSION,
    ids::BearerToken,
    limits::MAX_WRONG_PPM,
    message::{self, ClientMessage, Hello, Refusal, ServerMessage},
};
use gnomon_server::{
    Server,
    config::Transport,
    error::StartError,
    tokens::{self, Scope},
};

use super::{
    Rig,
    client::{Control, Frames, Native, certificate, client_config, hello},
    config, soon,
};

async fn refusal(control: &mut Control, hello: Hello) -> Refusal {
    control.send(&ClientMessage::Hello(hello)).await;
    let refusal = match control.receive().await {
        Some(ServerMessage::Refused(refusal)) => refusal,
        other => panic!("not refused: {other:?}"),
    };
    assert_eq!(control.receive().await, None, "nothing follows a refusal");
    assert!(control.received_bytes < 200, "{} bytes for a stranger", control.received_bytes);
    refusal
}

#[tokio::test(flavor = "multi_thread")]
async fn a_refused_client_gets_no_byte_of_the_scene() {
    let (ours, entry) = tokens::make("ours", None, &[Scope::Session], false).unwrap();
    let rig = Rig::start(|config, folder| {
        let tokens = folder.join("tokens");
        std::fs::write(&tokens, &entry).unwrap();
        config.token_file = Some(tokens);
    })
    .await;
    let digest = entry.split('"').find(|part| part.len() == 64).unwrap();
    for token in [None, Some(&ours[..63]), Some(""), Some(digest)] {
        let token = token.map(BearerToken::from);
        let mut client = Native::connect(rig.address(), rig.folder.path()).await;
        // Requesting the scene at once does not help.
        let mut eager = message::encode(&ClientMessage::Hello(Hello { token, ..hello() })).unwrap();
        eager.extend(message::encode(&ClientMessage::FetchScene { offset: 0 }).unwrap());
        client.control.send_bytes(&eager).await;
        assert_eq!(client.control.receive().await, Some(ServerMessage::Refused(Refusal::Token)));
        assert_eq!(client.control.receive().await, None);
        assert!(client.control.received_bytes < 100);
    }
    let mut client = Native::connect(rig.address(), rig.folder.path()).await;
    client.control.welcome(Hello { token: Some(ours.into()), ..hello() }).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn other_versions_and_impossible_sizes_are_refused_with_the_reason() {
    let rig = Rig::start(|_, _| {}).await;
    let client = PROTOCOL_VERSION + 1;
    let mut native = Native::connect(rig.address(), rig.folder.path()).await;
    let expected = Refusal::Version { server: PROTOCOL_VERSION, client };
    assert_eq!(refusal(&mut native.control, Hello { version: client, ..hello() }).await, expected);
    for (width, height) in [(0, 0), (0, 64), (100_000, 1), (4096, 4096)] {
        let mut native = Native::connect(rig.address(), rig.folder.path()).await;
        match refusal(&mut native.control, Hello { width, height, ..hello() }).await {
            Refusal::Unsupported(reason) => {
                assert!(reason.to_string().contains(&format!("{width}×{height}")), "{reason}");
            }
            other => panic!("{other:?}"),
        }
    }
    let wrong_ppm = MAX_WRONG_PPM + 1;
    let mut native = Native::connect(rig.address(), rig.folder.path()).await;
    let reason = "10001 wrong bits per million: at most 10000 are possible".into();
    assert_eq!(refusal(&mut native.control, Hello { wrong_ppm, ..hello() }).await, Refusal::Unsupported(reason));
    assert_eq!(rig.server.sessions(), 0);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_full_server_refuses_until_a_client_leaves() {
    let rig = Rig::start(|config, _| config.max_sessions = 1).await;
    let first = Native::started(rig.address(), rig.folder.path()).await;
    let mut second = Native::connect(rig.address(), rig.folder.path()).await;
    assert!(matches!(refusal(&mut second.control, hello()).await, Refusal::Full { sessions: 1, .. }));
    first.connection.close(0u32.into(), b"");
    rig.sessions(0).await;
    let third = Native::started(rig.address(), rig.folder.path()).await;
    third.frame(&mut Frames::new(), 0).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_protocol_violation_ends_only_its_session() {
    let rig = Rig::start(|_, _| {}).await;
    let good = Native::started(rig.address(), rig.folder.path()).await;
    let mut frames = Frames::new();
    good.frame(&mut frames, 0).await;
    let start = message::encode(&ClientMessage::Start).unwrap();
    for opening in [start, vec![0xff; 64], vec![1, 0, 0, 0, 77], b"GET / HTTP/1.1\r\n\r\n".to_vec()] {
        let mut bad = Native::connect(rig.address(), rig.folder.path()).await;
        bad.control.send_bytes(&opening).await;
        assert_eq!(bad.control.receive().await, None, "{opening:?}");
    }
    let fetch = ClientMessage::FetchScene { offset: 0 };
    for (messages, reason) in [
        (vec![ClientMessage::Hello(hello())], "a second Hello"),
        (vec![ClientMessage::FetchScene { offset: u64::MAX }], "does not exist"),
        (vec![ClientMessage::Start, ClientMessage::Start], "a second Start"),
        (vec![ClientMessage::Start, fetch.clone()], "before Start"),
        (vec![fetch; 5], "a few times"),
    ] {
        let mut bad = Native::connect(rig.address(), rig.folder.path()).await;
        bad.control.welcome(hello()).await;
        for message in &messages {
            bad.control.send(message).await;
        }
        let closing = loop {
            match bad.control.receive().await {
                Some(ServerMessage::SceneChunk { .. }) => {}
                other => break other,
            }
        };
        assert!(
            matches!(&closing, Some(ServerMessage::Closing { reason: said, .. }) if said.to_string().contains(reason)),
            "{closing:?}"
        );
        assert_eq!(bad.control.receive().await, None);
    }
    good.frame(&mut frames, 1).await;
    rig.sessions(1).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_silent_peer_is_disconnected() {
    let rig = Rig::start(|config, _| config.handshake_timeout_ms = 200).await;
    let silent = Native::connect(rig.address(), rig.folder.path()).await;
    soon(silent.connection.closed()).await;
    let foreign = quinn::Endpoint::client("127.0.0.1:0".parse().unwrap()).unwrap();
    let config = client_config(&certificate(rig.folder.path()), b"gnomon/0");
    assert!(soon(foreign.connect_with(config, rig.address(), "localhost").unwrap()).await.is_err());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_failed_start_names_its_reason() {
    let folder = tempfile::tempdir().unwrap();
    let base = || config(folder.path());
    let running = Server::start(base()).await.unwrap();
    let taken = gnomon_server::config::ServerConfig { listen: running.local_addr(), ..base() };
    let mut cases = vec![(taken, "is taken")];
    let mut case = |change: &dyn Fn(&mut gnomon_server::config::ServerConfig), part| {
        let mut config = base();
        change(&mut config);
        cases.push((config, part));
    };
    case(&|c| c.scene = None, "no scene: pass --scene FILE");
    case(&|c| c.scene = Some("/nowhere/scene.glb".into()), "/nowhere/scene.glb");
    case(&|c| c.token_file = Some("/nowhere/tokens".into()), "/nowhere/tokens");
    case(&|c| c.cert_dir = Some("/proc/nowhere".into()), "--cert-dir");
    case(&|c| c.listen = "192.0.2.1:0".parse().unwrap(), "192.0.2.1");
    for transport in [Transport::LabUdp, Transport::LabTcp] {
        case(
            &move |c| {
                c.transport = transport;
                c.listen = "0.0.0.0:0".parse().unwrap();
            },
            "loopback only",
        );
    }
    for (config, part) in cases {
        let error: StartError = Server::start(config).await.map(|server| server.url()).unwrap_err();
        assert!(error.to_string().contains(part), "{error}");
    }
}
