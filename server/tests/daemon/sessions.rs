//! Who is there: `/sessions`, `gnomon-server sessions`, and ending a session.

use std::{net::SocketAddr, path::Path};

use gnomon_protocol::message::{ClientMessage, Hello, ServerMessage};
use gnomon_server::{
    config::AdminAddress,
    sessions_command,
    tokens::{self, Scope},
};
use serde_json::Value;
use tokio::{
    io::{AsyncReadExt as _, AsyncWriteExt as _},
    net::TcpStream,
};

use super::{
    Rig,
    client::{Frames, Native, hello},
    operator::{get, value},
    soon,
};

async fn post(admin: SocketAddr, path: &str, secret: &str) -> (u16, String) {
    let mut stream = TcpStream::connect(admin).await.unwrap();
    let bearer = if secret.is_empty() { String::new() } else { format!("Authorization: Bearer {secret}\r\n") };
    let request = format!("POST {path} HTTP/1.1\r\nHost: localhost\r\nContent-Length: 0\r\n{bearer}\r\n");
    stream.write_all(request.as_bytes()).await.unwrap();
    let mut answer = String::new();
    soon(stream.read_to_string(&mut answer)).await.unwrap();
    let (head, body) = answer.split_once("\r\n\r\n").unwrap();
    (head.split(' ').nth(1).unwrap().parse().unwrap(), body.to_owned())
}

/// Runs `gnomon-server sessions`.
async fn command(admin: SocketAddr, secret: Option<&Path>, end: Option<u64>) -> Result<String, String> {
    let secret = secret.map(Path::to_owned);
    let run = move || sessions_command::run(Some(AdminAddress::At(admin)), secret.as_deref(), end);
    soon(tokio::task::spawn_blocking(run)).await.unwrap().map_err(|error| error.to_string())
}

#[tokio::test(flavor = "multi_thread")]
async fn an_operator_sees_who_is_there_and_ends_a_session() {
    let (alice, alices) = tokens::make("alice", None, &[Scope::Session], false).unwrap();
    let (look, looks) = tokens::make("ops", None, &[Scope::Admin], false).unwrap();
    let rig = Rig::start(|config, folder| {
        std::fs::write(folder.join("tokens"), alices + &looks).unwrap();
        std::fs::write(folder.join("secret"), format!("{look}\n")).unwrap();
        config.token_file = Some(folder.join("tokens"));
        config.admin = Some("127.0.0.1:0".parse().unwrap());
    })
    .await;
    let admin = rig.server.admin_addr().unwrap();
    let bearer = format!("Authorization: Bearer {look}\r\n");
    let mut client = Native::connect(rig.address(), rig.folder.path()).await;
    let name = "a\u{1b}[2J\u{202e}b".to_owned();
    let hello = Hello { token: Some(alice.as_str().into()), client: name.into(), rate_hz: 30, ..hello() };
    client.control.welcome(hello).await;
    client.control.send(&ClientMessage::Start).await;
    let mut frames = Frames::new();
    client.frame(&mut frames, 1).await;
    // The client moves to another address, as a phone does that leaves its wireless network.
    let socket = std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
    let moved_to = socket.local_addr().unwrap().to_string();
    client.endpoint.rebind(socket).unwrap();
    let mut number = 2;
    let session = soon(async {
        loop {
            client.frame(&mut frames, number).await;
            number += 1;
            let (status, text) = get(admin, "/sessions", &bearer).await;
            assert_eq!(status, 200, "{text}");
            assert!(!text.contains('\u{202e}') && !text.contains('\u{1b}'), "{text:?}");
            let list: Value = serde_json::from_str(&text).unwrap();
            let session = list["sessions"][0].clone();
            // Rates are measured once a second.
            if session["peer"] == moved_to.as_str() && session["bytes_per_s"].as_f64().unwrap() > 0.0 {
                return session;
            }
        }
    })
    .await;
    assert_eq!((&session["token"], &session["declared_hz"]), (&"alice".into(), &30.0.into()), "{session}");
    assert!(session["poses_per_s"].as_f64().unwrap() > 0.0, "{session}");
    assert!(session["device_ms_per_s"].as_f64().is_some() && session["frames_per_s"].as_f64().is_some(), "{session}");
    assert!(
        session["since"].as_str().is_some_and(|since| since.starts_with("20") && since.ends_with('Z')),
        "{session}"
    );

    let secret = rig.folder.path().join("secret");
    let table = command(admin, Some(&secret), None).await.unwrap();
    let (headings, row) = table.split_once('\n').unwrap();
    assert!(headings.starts_with("ID") && headings.contains("TOKEN"), "{table}");
    assert!(row.contains("alice") && row.contains(&moved_to) && row.contains("of 30/s"), "{table}");
    assert!(!table.contains('\u{1b}') && !table.contains('\u{202e}'), "{table:?}");
    assert!(command(admin, None, None).await.unwrap_err().contains("--secret FILE"));

    let id = session["id"].as_u64().unwrap();
    let path = format!("/sessions/{id}/end");
    for secret in ["", &alice, "nonsense"] {
        assert_eq!(post(admin, &path, secret).await.0, 401);
    }
    assert_eq!(get(admin, &path, &bearer).await.0, 405);
    for nobody in ["/sessions/4096/end", "/sessions/-1/end", "/sessions//end"] {
        assert_eq!(post(admin, nobody, &look).await.0, 404);
    }
    assert_eq!(rig.server.sessions(), 1);
    assert_eq!(command(admin, Some(&secret), Some(id)).await.unwrap(), format!("session {id} ends"));
    match client.control.receive().await {
        Some(ServerMessage::Closing { reason, may_return }) => {
            assert!(reason.to_string().contains("operator") && !may_return, "{reason}");
        }
        other => panic!("{other:?}"),
    }
    client.connection.close(0u32.into(), b"");
    rig.sessions(0).await;
    assert!(command(admin, Some(&secret), Some(id)).await.unwrap_err().contains("no such session"));
    assert_eq!(command(admin, Some(&secret), None).await.unwrap(), "no sessions");
    let page = get(admin, "/metrics", &bearer).await.1;
    assert_eq!(value(&page, "gnomon_sessions_closed_total{cause=\"operator\"}"), 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn without_an_admin_token_nobody_ends_a_session() {
    let rig = super::operator::with_admin().await;
    let admin = rig.server.admin_addr().unwrap();
    let client = Native::started(rig.address(), rig.folder.path()).await;
    client.frame(&mut Frames::new(), 1).await;
    assert!(command(admin, None, None).await.unwrap().contains("127.0.0.1:"));
    let id: Value = serde_json::from_str(&get(admin, "/sessions", "").await.1).unwrap();
    let id = id["sessions"][0]["id"].as_u64().unwrap();
    assert_eq!(post(admin, &format!("/sessions/{id}/end"), "").await.0, 401);
    assert!(command(admin, None, Some(id)).await.unwrap_err().contains("scope admin"));
    assert_eq!(rig.server.sessions(), 1);
}
