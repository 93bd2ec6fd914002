//! Operation: the admin address, complete counters, reloaded tokens and certificates.

use std::{net::SocketAddr, path::Path};

use gnomon_protocol::message::{ClientMessage, Hello, Refusal, ServerMessage};
use gnomon_server::tokens::{self, Scope};
use tokio::{
    io::{AsyncReadExt as _, AsyncWriteExt as _},
    net::TcpStream,
};

use super::{
    Rig,
    client::{Frames, Native, certificate, hello, pose_packet},
    soon,
};

pub(crate) async fn get(admin: SocketAddr, path: &str, more: &str) -> (u16, String) {
    let mut stream = TcpStream::connect(admin).await.unwrap();
    stream.write_all(format!("GET {path} HTTP/1.1\r\nHost: localhost\r\n{more}\r\n").as_bytes()).await.unwrap();
    let mut answer = String::new();
    soon(stream.read_to_string(&mut answer)).await.unwrap();
    let (head, body) = answer.split_once("\r\n\r\n").unwrap();
    (head.split(' ').nth(1).unwrap().parse().unwrap(), body.to_owned())
}

/// Reads a counter or gauge from the metrics page.
pub(crate) fn value(page: &str, name: &str) -> u64 {
    let line = page.lines().find(|line| line.rsplit_once(' ').is_some_and(|(found, _)| found == name));
    let line = line.unwrap_or_else(|| panic!("no {name} in\n{page}"));
    line.rsplit_once(' ').unwrap().1.parse().unwrap()
}

pub(crate) async fn page(rig: &Rig) -> String {
    let (status, page) = get(rig.server.admin_addr().unwrap(), "/metrics", "").await;
    assert_eq!(status, 200, "{page}");
    page
}

/// Sums a counter over its labels.
fn sum(page: &str, name: &str) -> u64 {
    let ours = page.lines().filter(|line| line.starts_with(&format!("{name}{{")));
    ours.map(|line| line.rsplit_once(' ').unwrap().1.parse::<u64>().unwrap()).sum()
}

pub(crate) async fn with_admin() -> Rig {
    Rig::start(|config, _| config.admin = Some("127.0.0.1:0".parse().unwrap())).await
}

#[tokio::test(flavor = "multi_thread")]
async fn the_admin_address_shows_the_servers_state() {
    let rig = with_admin().await;
    let admin = rig.server.admin_addr().unwrap();
    assert_eq!(get(admin, "/live", "").await, (200, "alive\n".to_owned()));
    let (status, ready) = get(admin, "/ready", "").await;
    assert!(status == 200 && ready.contains("\"backend\":\"cpu"), "{ready}");
    assert_eq!(get(admin, "/sessions", "").await, (200, "{\"sessions\":[]}".to_owned()));
    assert_eq!(get(admin, "/secrets", "").await.0, 404);
    let mut garbage = TcpStream::connect(admin).await.unwrap();
    garbage.write_all(&[0xff; 70_000]).await.unwrap();
    let post = TcpStream::connect(admin).await.unwrap();
    let (mut read, mut write) = post.into_split();
    write.write_all(b"POST /ready HTTP/1.1\r\nHost: localhost\r\nContent-Length: 9\r\n\r\n").await.unwrap();
    let mut answer = String::new();
    soon(read.read_to_string(&mut answer)).await.unwrap();
    assert!(answer.starts_with("HTTP/1.1 405"), "{answer}");

    let client = Native::started(rig.address(), rig.folder.path()).await;
    client.frame(&mut Frames::new(), 0).await;
    let (_, listed) = get(admin, "/sessions", "").await;
    let listed: serde_json::Value = serde_json::from_str(&listed).unwrap();
    let session = &listed["sessions"][0];
    assert_eq!((&session["client"], &session["carrier"]), (&"test".into(), &"quic".into()), "{listed}");
    assert_eq!(session["peer"], client.endpoint.local_addr().unwrap().to_string(), "{listed}");
    let found = page(&rig).await;
    assert_eq!((value(&found, "gnomon_ready"), value(&found, "gnomon_sessions")), (1, 1));

    // A draining server is alive but not ready.
    let Rig { server, folder } = rig;
    let stopping = tokio::spawn(server.shutdown());
    soon(async { while get(admin, "/ready", "").await.0 != 503 {} }).await;
    assert_eq!(get(admin, "/live", "").await.0, 200);
    client.connection.close(0u32.into(), b"");
    soon(stopping).await.unwrap();
    drop(folder);
}

/// Waits for the server's last message, and returns its reason.
async fn closing(client: &mut Native) -> String {
    loop {
        match client.control.receive().await {
            Some(ServerMessage::Closing { reason, may_return }) => {
                assert!(!may_return, "{reason}");
                return reason.to_string();
            }
            Some(_) => {}
            None => panic!("no reason"),
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn an_operator_ends_one_session_and_its_client_is_told() {
    let rig = with_admin().await;
    let folder = rig.folder.path();
    let stays = Native::started(rig.address(), folder).await;
    let mut goes = Native::connect(rig.address(), folder).await;
    let welcome = goes.control.welcome(hello()).await;
    goes.control.send(&ClientMessage::Start).await;
    goes.frame(&mut Frames::new(), 0).await;
    assert!(rig.server.end_session(welcome.session.0) && !rig.server.end_session(99));
    assert_eq!(closing(&mut goes).await, "the operator ended this session");
    rig.sessions(1).await;
    assert_eq!(value(&page(&rig).await, "gnomon_sessions_closed_total{cause=\"operator\"}"), 1);
    // Coming back at once is refused with a time to wait.
    let mut back = Native::connect(rig.address(), folder).await;
    back.control.send(&ClientMessage::Hello(Hello { resume: Some(welcome.resume), ..hello() })).await;
    let Some(ServerMessage::Refused(refusal)) = back.control.receive().await else { panic!("admitted") };
    assert!(refusal.retry_after().is_some() && refusal.to_string().contains("the operator"), "{refusal}");
    stays.frame(&mut Frames::new(), 1).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn every_datagram_and_every_frame_is_accounted_for() {
    let rig = with_admin().await;
    let address = rig.address();
    // Garbage belongs to no session.
    let stranger = tokio::net::UdpSocket::bind("127.0.0.1:0").await.unwrap();
    for _ in 0..50 {
        stranger.send_to(&[0x40; 300], address).await.unwrap();
    }
    let client = Native::started(address, rig.folder.path()).await;
    let mut frames = Frames::new();
    client.frame(&mut frames, 1).await;
    for number in 2..40 {
        client.frame(&mut frames, number).await;
        // An invalid pose and an old one.
        client.connection.send_datagram(b"no pose".as_slice().into()).unwrap();
        client.connection.send_datagram(pose_packet(1, 0).into()).unwrap();
    }
    let while_open = page(&rig).await;
    // The server may leave some unread.
    for sequence in 0..20 {
        client.send_pose(1_000_000 + sequence, 41);
    }
    tokio::time::sleep(std::time::Duration::from_millis(300)).await;
    client.connection.close(0u32.into(), b"");
    client.endpoint.wait_idle().await;
    rig.sessions(0).await;
    let sent = client.connection.stats();
    let found = page(&rig).await;

    let taken = |outcome: &str| value(&found, &format!("gnomon_datagrams_received_total{{outcome=\"{outcome}\"}}"));
    assert_eq!(taken("bad"), 38, "{found}");
    assert!(taken("stale") >= 38 && taken("taken") >= 39, "{found}");
    // Loopback loses nothing, so the server accounts for everything that the client sent.
    assert_eq!(sum(&found, "gnomon_datagrams_received_total"), sent.frame_tx.datagram, "{found}");
    let frames_traced = value(&found, "gnomon_frames_traced_total");
    assert_eq!(sum(&found, "gnomon_frames_total"), frames_traced, "{found}");
    assert!(frames_traced >= 39, "{found}");
    // Received by the client, and counted as sent by the server.
    let outcome = |outcome: &str| value(&found, &format!("gnomon_datagrams_sent_total{{outcome=\"{outcome}\"}}"));
    assert!(outcome("sent") >= sent.frame_rx.datagram, "{found}");
    let owner = |name: &str, owner: &str| value(&found, &format!("gnomon_udp_{name}_total{{owner=\"{owner}\"}}"));
    // The client's first packet and its answer to the Retry come before the session, its last packet after it.
    let total =
        owner("received", "session") + owner("received", "none") + value(&found, "gnomon_udp_kernel_drops_total");
    // A closed client answers late packets without counting them.
    let counted = sent.udp_tx.datagrams + 50;
    assert!((counted..=counted + 2).contains(&total), "{counted}: {found}");
    assert!(owner("received", "none") >= 50, "{found}");
    assert_eq!(
        value(&found, "gnomon_sessions_closed_total{cause=\"left\"}")
            + value(&found, "gnomon_sessions_closed_total{cause=\"lost\"}"),
        1
    );
    // Counters only grow.
    for line in while_open.lines().filter(|line| line.contains("_total")) {
        if let Some((name, before)) =
            line.rsplit_once(' ').filter(|_| !line.starts_with('#') && !line.contains("gpu_seconds"))
        {
            assert!(value(&found, name) >= before.parse().unwrap(), "{name} fell");
        }
    }
    for stage in ["trace", "encode", "send", "pose_to_sent"] {
        assert!(value(&found, &format!("gnomon_stage_seconds_count{{stage=\"{stage}\"}}")) >= 39, "{found}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn tokens_are_reloaded_and_a_single_use_token_admits_one_session() {
    let make = |once| tokens::make("", None, &[Scope::Session], once).unwrap();
    let [(first, first_entry), (second, second_entry), (once, once_entry)] = [make(false), make(false), make(true)];
    let (look, look_entry) = tokens::make("", None, &[Scope::Admin], false).unwrap();
    let write = |folder: &Path, text: &str| std::fs::write(folder.join("tokens"), text).unwrap();
    let rig = Rig::start(|config, folder| {
        write(folder, &(first_entry.clone() + &once_entry));
        config.token_file = Some(folder.join("tokens"));
        config.admin = Some("127.0.0.1:0".parse().unwrap());
    })
    .await;
    let say = async |token: &str| {
        let mut client = Native::connect(rig.address(), rig.folder.path()).await;
        client.control.send(&ClientMessage::Hello(Hello { token: Some(token.into()), ..hello() })).await;
        let answer = client.control.receive().await;
        (matches!(answer, Some(ServerMessage::Welcome(_))), answer, client)
    };
    let (admitted, _, mut early) = say(&first).await;
    let (only_once, _, mut spender) = say(&once).await;
    assert!(admitted && only_once);
    for token in [&once, &second] {
        assert_eq!(say(token).await.1, Some(ServerMessage::Refused(Refusal::Token)));
    }
    write(rig.folder.path(), "no tokens\n");
    rig.server.reload();
    assert!(say(&first).await.0, "a file that cannot be used changes nothing");
    assert!(early.connection.close_reason().is_none());
    write(rig.folder.path(), &(second_entry + &once_entry + &look_entry));
    rig.server.reload();
    assert_eq!(closing(&mut early).await, "its token was withdrawn");
    assert!(say(&second).await.0 && !say(&first).await.0);
    spender.control.send(&ClientMessage::Ping(7)).await;
    assert_eq!(spender.control.receive().await, Some(ServerMessage::Pong(7)), "a spent token's session stays");
    // Once the file lists a token for it, the page requires one.
    let admin = rig.server.admin_addr().unwrap();
    assert_eq!(get(admin, "/metrics", "").await.0, 401);
    assert_eq!(get(admin, "/sessions", &format!("Authorization: Bearer {second}\r\n")).await.0, 401);
    let (status, found) = get(admin, "/metrics", &format!("Authorization: Bearer {look}\r\n")).await;
    assert_eq!((status, value(&found, "gnomon_refusals_total{cause=\"token\"}")), (200, 3), "{found}");
    // The session ends once its client has had time to read why. Another of `first` may still have been open.
    soon(async {
        let authorization = format!("Authorization: Bearer {look}\r\n");
        while value(&get(admin, "/metrics", &authorization).await.1, "gnomon_sessions_closed_total{cause=\"token\"}")
            == 0
        {
            tokio::time::sleep(std::time::Duration::from_millis(20)).await;
        }
    })
    .await;
    assert_eq!(get(admin, "/ready", "").await.0, 200);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_certificate_is_rotated_and_sessions_stay() {
    let rig = with_admin().await;
    let folder = rig.folder.path();
    let old = certificate(folder);
    let client = Native::started(rig.address(), folder).await;
    let mut frames = Frames::new();
    client.frame(&mut frames, 0).await;
    std::fs::remove_file(folder.join("cert/identity.pem")).unwrap();
    rig.server.reload();
    assert_ne!(certificate(folder), old);
    let new = Native::started(rig.address(), folder).await;
    new.frame(&mut Frames::new(), 0).await;
    client.frame(&mut frames, 1).await;
}
