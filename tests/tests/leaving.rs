//! Promise: a client that is asked to leave says goodbye at once, leaves whole files, and tells by its exit code why it
//! ended. A file that cannot be written is one line, and the others are whole.
#![cfg(target_os = "linux")]
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

mod display;
mod leaver;

use std::{
    fs,
    io::{BufRead as _, BufReader, Read as _, Write as _},
    net::{TcpListener, TcpStream, UdpSocket},
    path::Path,
    process::{Command, Stdio},
    time::{Duration, Instant},
};

use display::Display;
use gnomon_client::record::{Record, replay::Records};
use gnomon_lab::rig::{
    PATIENCE, ServerProcess,
    program::{Outcome, Program, find},
};
use gnomon_protocol::{
    ids::{ResumeToken, SceneDigest, SessionId},
    message::{self, ClientMessage, ServerMessage, Welcome},
};
use leaver::{Stage, complaint, lines, signal, text, watch_frames};
use serde_json::Value;

/// More than any test waits for.
const ENDLESS: u32 = 1_000_000;

const SIGNALS: [(&str, &str, i32); 3] = [("INT", "SIGINT", 130), ("TERM", "SIGTERM", 143), ("HUP", "SIGHUP", 129)];

fn frames_recorded(file: &Path) -> usize {
    let (_, mut records) = Records::open(file).unwrap();
    let mut frames = 0;
    while let Some(record) = records.next().unwrap() {
        frames += usize::from(matches!(record, Record::Frame { .. }));
    }
    frames
}

fn assert_left(server: &mut ServerProcess) {
    server.program().wait_for(PATIENCE, |said| said.contains("the client left").then_some(())).unwrap();
}

fn only_server(stage: &Stage) -> ServerProcess {
    ServerProcess::start(&stage.scene, &["--backend", "cpu", "--max-sessions", "1"]).unwrap()
}

#[test]
fn each_signal_ends_a_run_with_whole_files_and_its_own_code() {
    let stage = Stage::new();
    for (name, full_name, code) in SIGNALS {
        let mut server = only_server(&stage);
        let files = ["stats", "summary", "pictures", "recording"].map(|file| stage.file(&format!("{name}-{file}")));
        let [stats, summary, pictures, recording] = &files;
        let mut more = vec!["--stats", text(stats), "--summary", text(summary), "--out", text(pictures)];
        more.extend(["--record", text(recording)]);
        // One that waits for its masks ends as well.
        more.extend((name == "TERM").then_some("--wait"));
        let mut client = stage.client(server.url(), ENDLESS, &more, "off");
        watch_frames(&mut client, stats, 5);
        signal(&client, name);
        let Outcome { status, stdout, stderr } = client.finish(PATIENCE).unwrap();
        assert_eq!((status.code(), stderr.as_str()), (Some(code), ""), "{name}");
        assert_left(&mut server);

        let told: Value = serde_json::from_str(&stdout).unwrap();
        let written: Value = serde_json::from_slice(&fs::read(summary).unwrap()).unwrap();
        assert_eq!(told, written);
        assert_eq!((&told["stopped_by"], &told["connection_lost"]), (&full_name.into(), &Value::Null));
        assert_eq!(told["lost_at_end"], Value::Null);
        let frames = usize::try_from(told["frames_rendered"].as_u64().unwrap()).unwrap();
        assert!(fs::read_to_string(stats).unwrap().ends_with('\n'));
        assert_eq!((lines(stats).len(), frames_recorded(recording)), (frames, frames), "{name}");
        for frame in 0..frames {
            image::open(pictures.join(format!("frame_{frame:06}.png"))).unwrap();
        }
        assert_eq!(fs::read_dir(pictures).unwrap().count(), frames);
        // The only place is free again.
        stage.client(server.url(), 1, &[], "off").finish(PATIENCE).unwrap().success().unwrap();
        server.stop().unwrap();
    }
}

/// Reads a client's message.
fn read(stream: &mut TcpStream) -> ClientMessage {
    let mut prefix = [0; 4];
    stream.read_exact(&mut prefix).unwrap();
    let mut bytes = vec![0; message::decode_length(prefix).unwrap()];
    stream.read_exact(&mut bytes).unwrap();
    message::decode(&bytes).unwrap()
}

/// Admits a client, and returns the stream once it asks for the scene, which is not sent.
fn admit(listener: &TcpListener) -> TcpStream {
    let (mut stream, _) = listener.accept().unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    assert!(matches!(read(&mut stream), ClientMessage::Hello(_)));
    let welcome = ServerMessage::Welcome(Welcome {
        session: SessionId(1),
        scene_digest: SceneDigest([7; 32]),
        scene_bytes: 1000,
        lights: 1,
        backend: "none".into(),
        data_port: Some(1),
        resume: ResumeToken([7; 16]),
        may_edit: true,
        shared_world: false,
        revision: 0,
    });
    stream.write_all(&message::encode(&welcome).unwrap()).unwrap();
    assert_eq!(read(&mut stream), ClientMessage::FetchScene { offset: 0 });
    stream
}

#[test]
fn a_client_can_leave_before_its_first_frame() {
    let stage = Stage::new();
    let patient = ["--connect-timeout", "3600"];
    let ends = |client: Program, name: &str, code: i32| {
        signal(&client, name);
        let outcome = client.finish(PATIENCE).unwrap();
        assert_eq!((outcome.status.code(), outcome.stdout.as_str()), (Some(code), ""), "{}", outcome.stderr);
        outcome.stderr
    };

    // Nobody answers.
    let silent = UdpSocket::bind("127.0.0.1:0").unwrap();
    silent.set_read_timeout(Some(PATIENCE)).unwrap();
    let url = format!("gnomon://{}/?cert={}", silent.local_addr().unwrap(), "ab".repeat(32));
    let client = stage.client(&url, 1, &patient, "off");
    silent.recv(&mut [0; 2048]).unwrap();
    assert_eq!(ends(client, "INT", 130), "");

    // The server sends no scene.
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let url = format!("gnomon+lab-tcp://{}/", listener.local_addr().unwrap());
    let client = stage.client(&url, 1, &patient, "off");
    let mut stream = admit(&listener);
    assert_eq!(ends(client, "TERM", 143), "");
    assert_eq!(stream.read(&mut [0]).unwrap(), 0);

    // The server is full, and says when to ask again.
    let server = only_server(&stage);
    let stats = stage.file("first");
    let mut first = stage.client(server.url(), ENDLESS, &["--stats", text(&stats)], "off");
    watch_frames(&mut first, &stats, 1);
    let mut second = stage.client(server.url(), 1, &patient, "warn");
    second.wait_for(PATIENCE, |said| said.contains("asking again").then_some(())).unwrap();
    assert!(!ends(second, "HUP", 129).contains("gnomon-client: "));
    server.stop().unwrap();
}

#[test]
fn a_busy_client_leaves_its_server_at_the_first_signal_and_ends_at_the_second() {
    let stage = Stage::new();
    let mut server = only_server(&stage);
    // Opening a pipe that nobody reads blocks the client between its admission and its start.
    let pipe = stage.file("pipe");
    assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    let cache = stage.file("cache");
    let mut client = stage.client(server.url(), 1, &["--record", text(&pipe), "--cache-dir", text(&cache)], "off");
    let (begun, fetched) = (Instant::now(), |entry: fs::DirEntry| entry.path().extension() == Some("scene".as_ref()));
    while !fs::read_dir(&cache).is_ok_and(|entries| entries.flatten().any(fetched)) {
        assert!(begun.elapsed() < PATIENCE && client.is_running().unwrap(), "{:?}", client.said());
        std::thread::sleep(Duration::from_millis(20));
    }
    signal(&client, "TERM");
    server.program().wait_for(PATIENCE, |said| said.contains("session ended").then_some(())).unwrap();
    assert!(client.is_running().unwrap());
    signal(&client, "INT");
    assert_eq!(client.finish(PATIENCE).unwrap().status.code(), Some(130));
    server.stop().unwrap();
}

#[test]
fn a_client_under_nohup_outlives_its_terminal() {
    let stage = Stage::new();
    let server = only_server(&stage);
    let stats = stage.file("stats");
    let mut all = vec!["-c".into(), r#"trap "" HUP; exec "$0" "$@""#.into()];
    all.push(find("gnomon-client").unwrap().into_os_string());
    all.extend(stage.arguments(server.url(), ENDLESS, &["--stats", text(&stats)]));
    let mut client = Program::start(Path::new("/bin/sh"), &all, &[("RUST_LOG", "off")]).unwrap();
    watch_frames(&mut client, &stats, 3);
    signal(&client, "HUP");
    let drawn = lines(&stats).len();
    watch_frames(&mut client, &stats, drawn + 10);
    signal(&client, "TERM");
    assert_eq!(client.finish(PATIENCE).unwrap().status.code(), Some(143));
    server.stop().unwrap();
}

#[test]
fn a_window_leaves_when_it_is_closed_or_asked() {
    let (stage, display) = (Stage::new(), Display::start());
    let environment = [("DISPLAY", display.name.as_str()), ("WAYLAND_DISPLAY", ""), ("RUST_LOG", "off")];
    let open = |url: &str, more: &[&str]| {
        let mut all = vec![url, "--size", "160x90", "--allow-software", "--vsync=false"];
        all.extend(more);
        Program::start(&find("gnomon-client").unwrap(), &all, &environment).unwrap()
    };
    let close = || {
        let id = display.person("search --sync --name Gnomon");
        display.focus(id.lines().next().unwrap());
        display.person("key Escape");
    };
    let mut server = only_server(&stage);
    let (stats, recording) = (stage.file("stats"), stage.file("recording"));
    let mut asked = open(server.url(), &["--stats", text(&stats), "--record", text(&recording)]);
    watch_frames(&mut asked, &stats, 3);
    signal(&asked, "TERM");
    let outcome = asked.finish(PATIENCE).unwrap();
    assert_eq!((outcome.status.code(), outcome.stderr.as_str()), (Some(143), ""));
    assert_left(&mut server);
    assert_eq!(lines(&stats).len(), frames_recorded(&recording));
    server.stop().unwrap();

    // Closed while it waits for the scene, it leaves as well.
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let closed = open(&format!("gnomon+lab-tcp://{}/", listener.local_addr().unwrap()), &[]);
    let mut stream = admit(&listener);
    close();
    closed.finish(PATIENCE).unwrap().success().unwrap();
    assert_eq!(stream.read(&mut [0]).unwrap(), 0);
}

/// Runs a client whose files can have this many KiB. They are then too large, as on a full disk.
fn limited(stage: &Stage, url: &str, kib: u32, more: &[&str]) -> Outcome {
    let script = format!(r#"trap "" XFSZ; ulimit -f {kib}; exec "$0" "$@""#);
    let mut all = vec!["-c".into(), script.into(), find("gnomon-client").unwrap().into_os_string()];
    all.extend(stage.arguments(url, 400, more));
    Program::start(Path::new("/bin/bash"), &all, &[("RUST_LOG", "off")]).unwrap().finish(PATIENCE).unwrap()
}

#[track_caller]
fn assert_fails_with(outcome: &Outcome, words: &[&str]) {
    assert_eq!(outcome.status.code(), Some(1), "{}", outcome.stderr);
    assert_eq!(outcome.stderr.lines().count(), 1, "{}", outcome.stderr);
    let line = complaint(&outcome.stderr).to_lowercase();
    assert!(words.iter().all(|word| line.contains(&word.to_lowercase())), "{words:?}: {line}");
}

#[test]
fn a_file_that_cannot_be_written_fails_the_run_and_what_is_written_can_be_read() {
    let stage = Stage::new();
    let mut server = only_server(&stage);
    let (stats, recording, pictures) = (stage.file("stats"), stage.file("recording"), stage.file("pictures"));

    let outcome = limited(&stage, server.url(), 16, &["--stats", text(&stats), "--out", text(&pictures)]);
    assert_fails_with(&outcome, &["cannot write", text(&stats), "too large"]);
    assert_left(&mut server);
    let whole = fs::read_to_string(&stats).unwrap();
    assert!(whole.ends_with('\n') && lines(&stats).len() == whole.lines().count() && whole.lines().count() > 5);
    let written: Vec<_> = fs::read_dir(&pictures).unwrap().map(|entry| image::open(entry.unwrap().path())).collect();
    assert!(written.len() >= lines(&stats).len() && written.iter().all(Result::is_ok), "{} pictures", written.len());

    let outcome = limited(&stage, server.url(), 16, &["--record", text(&recording)]);
    assert_fails_with(&outcome, &["cannot write", text(&recording), "too large"]);
    assert!(frames_recorded(&recording) > 5);

    let outcome = stage.client(server.url(), 400, &["--mask-log", "/dev/full"], "off").finish(PATIENCE).unwrap();
    assert_fails_with(&outcome, &["/dev/full", "no space left"]);
    let waits = stage.client(server.url(), 400, &["--mask-log", "/dev/full", "--wait"], "off");
    assert_fails_with(&waits.finish(PATIENCE).unwrap(), &["/dev/full", "no space left"]);

    // The reader of the statistics goes away.
    let pipe = stage.file("pipe");
    assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    let client = stage.client(server.url(), 400, &["--stats", text(&pipe)], "off");
    let mut line = String::new();
    BufReader::new(fs::File::open(&pipe).unwrap()).read_line(&mut line).unwrap();
    assert!(line.ends_with("}\n"), "{line}");
    assert_fails_with(&client.finish(PATIENCE).unwrap(), &["cannot write", text(&pipe), "broken pipe"]);
    server.stop().unwrap();
}

#[test]
fn a_log_that_nobody_reads_ends_nothing() {
    let stage = Stage::new();
    let server = only_server(&stage);
    let summary = stage.file("summary");
    let mut client = Command::new(find("gnomon-client").unwrap());
    client.args(stage.arguments(server.url(), 20, &["--summary", text(&summary)]));
    client.env("RUST_LOG", "debug").env("HOME", stage.file("home")).stdout(Stdio::null()).stderr(Stdio::piped());
    let mut client = client.spawn().unwrap();
    // Waits for the first line, then closes the pipe.
    BufReader::with_capacity(1, client.stderr.take().unwrap()).read_line(&mut String::new()).unwrap();
    let begun = Instant::now();
    let status = loop {
        if let Some(status) = client.try_wait().unwrap() {
            break status;
        }
        assert!(begun.elapsed() < PATIENCE);
        std::thread::sleep(Duration::from_millis(20));
    };
    assert!(status.success(), "{status}");
    let summary: Value = serde_json::from_slice(&fs::read(&summary).unwrap()).unwrap();
    assert_eq!(summary["frames_rendered"], 20);
    server.stop().unwrap();
}
