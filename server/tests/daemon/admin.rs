//! The admin address under attack, and after reloads that went wrong.

use std::{net::SocketAddr, path::Path};

use gnomon_protocol::message::{ClientMessage, Hello, ServerMessage};
use gnomon_server::{
    limits::MAX_ADMIN_CONNECTIONS,
    tokens::{self, Scope},
};
use tokio::{
    io::{AsyncReadExt as _, AsyncWriteExt as _},
    net::TcpStream,
};

use super::{
    Rig,
    client::{Native, hello},
    operator::{get, value, with_admin},
    soon,
};

/// A connection that sends `text` and waits.
async fn connection(admin: SocketAddr, text: &str) -> TcpStream {
    let mut stream = TcpStream::connect(admin).await.unwrap();
    stream.write_all(text.as_bytes()).await.unwrap();
    stream
}

#[tokio::test(flavor = "multi_thread")]
async fn probes_are_answered_however_many_connections_wait() {
    let rig = with_admin().await;
    let admin = rig.server.admin_addr().unwrap();
    let half = "GET /live HTTP/1.1\r\n";
    let mut waiting = Vec::new();
    for _ in 0..3 * MAX_ADMIN_CONNECTIONS {
        waiting.push(connection(admin, half).await);
    }
    for _ in 0..MAX_ADMIN_CONNECTIONS {
        waiting.push(connection(admin, "GET /metrics HTTP/1.1\r\nHost: localhost\r\n\r\n").await);
    }
    // These come back as soon as they are dropped.
    let returning: Vec<_> = (0..32)
        .map(|_| {
            tokio::spawn(async move {
                loop {
                    let mut stream = connection(admin, half).await;
                    let _ = stream.read(&mut [0]).await;
                }
            })
        })
        .collect();
    for _ in 0..20 {
        assert_eq!(get(admin, "/live", "").await.0, 200);
        assert_eq!(get(admin, "/ready", "").await.0, 200);
    }
    for task in returning {
        task.abort();
    }
    // Nobody keeps a place for ever.
    for mut stream in waiting {
        soon(async { while stream.read(&mut [0; 4096]).await.is_ok_and(|bytes| bytes > 0) {} }).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn the_admin_address_answers_to_its_own_names_only() {
    let rig = Rig::start(|config, _| {
        config.admin = Some("127.0.0.1:0".parse().unwrap());
        config.admin_hosts = Some("gnomon".parse().unwrap());
    })
    .await;
    let admin = rig.server.admin_addr().unwrap();
    for (host, status) in
        [(admin.to_string().as_str(), 200), ("localhost", 200), ("gnomon:9464", 200), ("evil.example", 421), ("", 421)]
    {
        for path in ["/live", "/ready", "/metrics", "/sessions"] {
            let mut stream = connection(admin, &format!("GET {path} HTTP/1.1\r\nHost: {host}\r\n\r\n")).await;
            let mut answer = String::new();
            soon(stream.read_to_string(&mut answer)).await.unwrap();
            assert!(answer.starts_with(&format!("HTTP/1.1 {status}")), "{host} {path}: {answer}");
            assert!(status == 200 || answer.contains("--admin-hosts") && !answer.contains("cpu"), "{answer}");
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_server_that_everybody_reaches_says_so() {
    let open = async |listen: &str| {
        let rig = Rig::start(|config, _| {
            config.listen = listen.parse().unwrap();
            config.admin = Some("127.0.0.1:0".parse().unwrap());
        })
        .await;
        let admin = rig.server.admin_addr().unwrap();
        let ready: serde_json::Value = serde_json::from_str(&get(admin, "/ready", "").await.1).unwrap();
        let page = get(admin, "/metrics", "").await.1;
        (ready["open"].as_bool().unwrap(), value(&page, "gnomon_open"))
    };
    assert_eq!(open("0.0.0.0:0").await, (true, 1));
    assert_eq!(open("127.0.0.1:0").await, (false, 0));
}

/// Ways to spoil a token file, each with a name.
fn spoil(path: &Path, how: &str) {
    std::fs::remove_file(path).unwrap();
    match how {
        "missing" => {}
        "unreadable" => std::fs::create_dir(path).unwrap(),
        "empty" => std::fs::write(path, "").unwrap(),
        "broken" => std::fs::write(path, "[[token]\n").unwrap(),
        other => panic!("{other}"),
    }
}

const SPOILT: [&str; 4] = ["missing", "unreadable", "empty", "broken"];

struct Tokens {
    session: (String, String),
    admin: (String, String),
}

impl Tokens {
    fn make() -> Self {
        let make = |scope| tokens::make("", None, &[scope], false).unwrap();
        Self { session: make(Scope::Session), admin: make(Scope::Admin) }
    }

    async fn server(&self, first: &str) -> Rig {
        Rig::start(|config, folder| {
            std::fs::write(folder.join("tokens"), first).unwrap();
            config.token_file = Some(folder.join("tokens"));
            config.admin = Some("127.0.0.1:0".parse().unwrap());
        })
        .await
    }

    /// Checks whether the server admits the session token, and nobody without one.
    async fn admits(&self, rig: &Rig) -> bool {
        let mut admitted = Vec::new();
        for token in [None, Some(self.session.0.as_str().into())] {
            let mut client = Native::connect(rig.address(), rig.folder.path()).await;
            client.control.send(&ClientMessage::Hello(Hello { token, ..hello() })).await;
            admitted.push(matches!(client.control.receive().await, Some(ServerMessage::Welcome(_))));
            client.connection.close(0u32.into(), b"");
        }
        assert!(!admitted[0], "nobody comes in without a token");
        admitted[1]
    }
}

fn reload(rig: &Rig, text: &str) {
    let path = rig.folder.path().join("tokens");
    if path.is_dir() {
        std::fs::remove_dir(&path).unwrap();
    }
    std::fs::write(path, text).unwrap();
    rig.server.reload();
}

#[tokio::test(flavor = "multi_thread")]
async fn no_reload_opens_what_was_closed() {
    let tokens = Tokens::make();
    let both = format!("{}{}", tokens.session.1, tokens.admin.1);
    let rig = tokens.server(&both).await;
    let admin = rig.server.admin_addr().unwrap();
    let secret = format!("Authorization: Bearer {}\r\n", tokens.admin.0);
    let closed = async || {
        for path in ["/metrics", "/sessions"] {
            assert_eq!(get(admin, path, "").await.0, 401);
        }
    };
    let failed = async || {
        let (status, page) = get(admin, "/metrics", &secret).await;
        assert_eq!(status, 200, "{page}");
        assert!(value(&page, "gnomon_reload_success_timestamp_seconds{what=\"tokens\"}") > 1_000_000_000);
        assert_eq!(value(&page, "gnomon_reload_failed{what=\"certificate\"}"), 0);
        value(&page, "gnomon_reload_failed{what=\"tokens\"}")
    };
    closed().await;
    assert_eq!(failed().await, 0);
    for how in SPOILT {
        spoil(&rig.folder.path().join("tokens"), how);
        rig.server.reload();
        closed().await;
        assert_eq!(failed().await, 1, "{how}");
        assert!(tokens.admits(&rig).await, "{how}: the old tokens stay");
        reload(&rig, &both);
        assert_eq!(failed().await, 0, "after {how}");
    }
    // The last token for sessions is withdrawn: such a file is refused.
    reload(&rig, &tokens.admin.1);
    closed().await;
    assert_eq!(failed().await, 1);
    assert!(tokens.admits(&rig).await);
    // The last token for the admin address is withdrawn: nobody has it any more.
    reload(&rig, &tokens.session.1);
    closed().await;
    assert_eq!(get(admin, "/metrics", &secret).await.0, 401);
    assert!(tokens.admits(&rig).await);
    assert_eq!(get(admin, "/live", "").await.0, 200);
    reload(&rig, &both);
    assert_eq!(failed().await, 0);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_server_that_never_listed_an_admin_token_stays_open_to_readers_until_one_is_listed() {
    let tokens = Tokens::make();
    let rig = tokens.server(&tokens.session.1).await;
    let admin = rig.server.admin_addr().unwrap();
    for how in SPOILT {
        spoil(&rig.folder.path().join("tokens"), how);
        rig.server.reload();
        let (status, page) = get(admin, "/metrics", "").await;
        assert_eq!((status, value(&page, "gnomon_reload_failed{what=\"tokens\"}")), (200, 1), "{how}");
        reload(&rig, &tokens.session.1);
        let page = get(admin, "/metrics", "").await.1;
        assert_eq!(value(&page, "gnomon_reload_failed{what=\"tokens\"}"), 0, "after {how}");
    }
    // Nobody asks between these two.
    reload(&rig, &format!("{}{}", tokens.session.1, tokens.admin.1));
    reload(&rig, &tokens.session.1);
    assert_eq!(get(admin, "/metrics", "").await.0, 401, "once closed, it stays closed");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_certificate_that_cannot_be_reloaded_is_a_metric() {
    let rig = with_admin().await;
    let admin = rig.server.admin_addr().unwrap();
    let failed = async || value(&get(admin, "/metrics", "").await.1, "gnomon_reload_failed{what=\"certificate\"}");
    let identity = rig.folder.path().join("cert/identity.pem");
    let good = std::fs::read(&identity).unwrap();
    assert_eq!(failed().await, 0);
    std::fs::write(&identity, "no certificate").unwrap();
    rig.server.reload();
    assert_eq!(failed().await, 1);
    std::fs::write(&identity, good).unwrap();
    rig.server.reload();
    assert_eq!(failed().await, 0);
}
