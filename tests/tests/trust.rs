//! Promise: neither end trusts what the other one writes. A token goes to no server that nobody vouched for, and a name
//! that a client gives itself forges no line of a log.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use std::{
    fs,
    io::{Read as _, Write as _},
    net::TcpStream,
    path::Path,
};

use gnomon_lab::rig::{
    PATIENCE, ServerProcess,
    program::{Outcome, Program, find},
};
use gnomon_protocol::{
    PROTOCOL_VERSION,
    codec::CodecId,
    message::{self, ClientMessage, Hello, ServerMessage},
};
use gnomon_server::tokens::{self, Scope};

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

#[test]
fn a_token_goes_to_no_server_that_nobody_vouched_for() {
    let folder = tempfile::tempdir().unwrap();
    let scene = gnomon_scene::testing::write_scene(folder.path()).unwrap();
    let (ours, entry) = tokens::make("ours", None, &[Scope::Session], false).unwrap();
    let [token, list, state] = ["token", "tokens.toml", "state"].map(|name| folder.path().join(name));
    fs::write(&list, entry).unwrap();
    let server = ServerProcess::start(&scene, &["--backend", "cpu", "--token-file", text(&list)]).unwrap();
    let (address, sha256) = server.url().split_once("/?cert=").unwrap();
    let first_use = format!("{address}/?cert=first-use");
    let visit = |said: &str, more: &[&str]| -> Outcome {
        fs::write(&token, said).unwrap();
        let arguments = [&first_use, "--headless", "--frames", "1", "--size", "64x36", "--token-file", text(&token)];
        let environment = [("XDG_STATE_HOME", text(&state)), ("RUST_LOG", "off")];
        let program = Program::start(&find("gnomon-client").unwrap(), &[&arguments, more].concat(), &environment);
        program.unwrap().finish(PATIENCE).unwrap()
    };
    let kept = || fs::read_to_string(state.join("gnomon/servers.json")).unwrap_or_default();

    // Asked by nobody, it stays at home, and the server does not count as known.
    let refused = visit(&ours, &[]);
    assert!(!refused.status.success());
    for words in ["first visit", sha256, "--trust-first-use"] {
        assert!(refused.stderr.contains(words), "{words}: {}", refused.stderr);
    }
    assert_eq!((refused.stderr.lines().count(), kept().as_str()), (1, ""));
    // A server that refuses the token was visited all the same: nobody else can take its place.
    let wrong = visit("wrong", &["--trust-first-use"]);
    assert!(!wrong.status.success() && wrong.stderr.contains("token"), "{}", wrong.stderr);
    assert!(kept().contains(sha256), "{}", kept());
    visit(&ours, &[]).success().unwrap();
    // A list that cannot be read does not make it the first visit again.
    fs::write(state.join("gnomon/servers.json"), "{").unwrap();
    let damaged = visit(&ours, &["--trust-first-use"]);
    assert!(!damaged.status.success() && damaged.stderr.contains("servers.json"), "{}", damaged.stderr);
    server.stop().unwrap();
}

/// Every character that ends a line, moves a cursor, reorders a line, or is not seen.
fn hidden() -> String {
    let ranges = ['\0'..='\u{1f}', '\u{7f}'..='\u{9f}', '\u{200b}'..='\u{200f}', '\u{2028}'..='\u{202e}'];
    let more = ['\u{ad}', '\u{61c}', '\u{2060}', '\u{2066}', '\u{2067}', '\u{2068}', '\u{2069}', '\u{feff}'];
    ranges.into_iter().flatten().chain(more).collect()
}

#[test]
fn what_a_client_writes_forges_no_line_in_any_log_format() {
    let folder = tempfile::tempdir().unwrap();
    let scene = gnomon_scene::testing::write_scene(folder.path()).unwrap();
    let evil = format!("evil{}\n2026-01-01T00:00:00Z ERROR forged", hidden());
    for format in ["pretty", "json"] {
        let log = folder.path().join(format);
        let arguments = ["--transport", "lab-tcp", "--backend", "cpu", "--log", format, "--log-file", text(&log)];
        let server = ServerProcess::start(&scene, &arguments).unwrap();
        let address = server.url().strip_prefix("gnomon+lab-tcp://").unwrap().trim_end_matches('/').to_owned();
        let hello = Hello {
            version: PROTOCOL_VERSION,
            token: Some(evil.as_str().into()),
            client: evil.as_str().into(),
            width: 64,
            height: 48,
            codec: CodecId::PlanesLz4,
            rate_hz: 0,
            wrong_ppm: 0,
            resume: None,
        };
        let mut stream = TcpStream::connect(address).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        stream.write_all(&message::encode(&ClientMessage::Hello(hello)).unwrap()).unwrap();
        let mut prefix = [0; 4];
        stream.read_exact(&mut prefix).unwrap();
        let mut answer = vec![0; message::decode_length(prefix).unwrap()];
        stream.read_exact(&mut answer).unwrap();
        assert!(matches!(message::decode(&answer), Ok(ServerMessage::Welcome(_))));
        stream.write_all(&message::encode(&ClientMessage::Bye).unwrap()).unwrap();
        stream.read_to_end(&mut answer).unwrap();
        server.stop().unwrap();
        let log = fs::read_to_string(&log).unwrap();
        assert!(log.contains("evil") && log.contains("session ended"), "{format}: {log}");
        for line in log.lines() {
            let seen = |shown: char| !shown.is_control() && !hidden().contains(shown);
            assert!(line.chars().all(seen) && !line.starts_with("2026-01-01"), "{format}: {line:?}");
        }
    }
}
