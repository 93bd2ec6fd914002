//! Promise: every log line fits `deploy/logs.schema.json`, the log file can be rotated, and a full disk does not stop
//! the server.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use std::{
    collections::BTreeSet,
    fs,
    io::{Read as _, Write as _},
    net::TcpStream,
    path::{Path, PathBuf},
    process::Command,
    time::{Duration, Instant},
};

use gnomon_lab::rig::{
    ClientJob, PATIENCE,
    program::{Program, find},
};
use serde_json::{Value, json};

fn project(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(path)
}

fn schema() -> jsonschema::Validator {
    let text = fs::read_to_string(project("deploy/logs.schema.json")).unwrap();
    let schema: Value = serde_json::from_str(&text).unwrap();
    jsonschema::draft202012::meta::validate(&schema).unwrap();
    jsonschema::validator_for(&schema).unwrap()
}

struct Server {
    program: Program,
    url: String,
    admin: String,
}

/// Starts a server on free ports that logs JSON into `log`.
fn start(folder: &Path, log: &Path) -> Server {
    start_with(folder, log, &[], &[("RUST_LOG", "warn,gnomon_server=debug")])
}

fn start_with(folder: &Path, log: &Path, more: &[&str], environment: &[(&str, &str)]) -> Server {
    let arguments = [
        "--scene".into(),
        gnomon_scene::testing::write_scene(folder).unwrap().display().to_string(),
        "--backend=cpu".into(),
        "--listen=127.0.0.1:0".into(),
        "--admin=0".into(),
        "--log=json".into(),
        format!("--cert-dir={}", folder.join("cert").display()),
        format!("--log-file={}", log.display()),
    ];
    let arguments: Vec<_> = arguments.into_iter().chain(more.iter().map(|more| (*more).to_owned())).collect();
    let mut program = Program::start(&find("gnomon-server").unwrap(), &arguments, environment).unwrap();
    let url = program.wait_for(PATIENCE, |said| said.strip_suffix('\n').map(str::to_owned)).unwrap();
    // The log names the chosen port; if the disk is full, the system does.
    let admin = listening_tcp(program.id());
    Server { program, url, admin }
}

/// Returns the address on which a process listens for TCP.
fn listening_tcp(id: u32) -> String {
    let sockets: BTreeSet<String> = fs::read_dir(format!("/proc/{id}/fd"))
        .unwrap()
        .filter_map(|file| fs::read_link(file.unwrap().path()).ok())
        .filter_map(|link| Some(link.to_str()?.strip_prefix("socket:[")?.strip_suffix(']')?.to_owned()))
        .collect();
    let table = fs::read_to_string(format!("/proc/{id}/net/tcp")).unwrap();
    let port = table.lines().skip(1).find_map(|line| {
        let columns: Vec<_> = line.split_ascii_whitespace().collect();
        let listens = columns[3] == "0A" && sockets.contains(columns[9]);
        listens.then(|| u16::from_str_radix(columns[1].rsplit_once(':').unwrap().1, 16).unwrap())
    });
    format!("127.0.0.1:{}", port.expect("it listens"))
}

fn client(url: &str, folder: &Path) -> Value {
    let keyframe = |t: f64| json!({ "t": t, "pos": [0.1 * t, 2.5, 0.5], "target": [0.0, 0.0, 0.0] });
    let path = json!({ "yfov_deg": 60.0, "camera_path": { "keyframes": [keyframe(0.0), keyframe(3.0)] } });
    fs::write(folder.join("path.json"), path.to_string()).unwrap();
    let job = ClientJob {
        url: Some(url),
        path: folder.join("path.json").into(),
        frames: 60,
        size: (96, 54),
        folder,
        save_masks: false,
        arguments: vec!["--wait".into(), "--fps".into(), "20".into()],
    };
    job.start().unwrap().finish(PATIENCE).unwrap().success().unwrap();
    job.summary().unwrap()
}

fn metrics(admin: &str) -> String {
    let mut stream = TcpStream::connect(admin).unwrap();
    stream.write_all(b"GET /metrics HTTP/1.1\r\nHost: localhost\r\n\r\n").unwrap();
    let mut page = String::new();
    stream.read_to_string(&mut page).unwrap();
    page
}

fn value(page: &str, name: &str) -> u64 {
    let line = page.lines().find(|line| line.rsplit_once(' ').is_some_and(|(found, _)| found == name));
    line.unwrap_or_else(|| panic!("no {name} in\n{page}")).rsplit_once(' ').unwrap().1.parse().unwrap()
}

fn wait_until(mut done: impl FnMut() -> bool) {
    let start = Instant::now();
    while !done() {
        assert!(start.elapsed() < PATIENCE);
        std::thread::sleep(Duration::from_millis(20));
    }
}

#[test]
fn every_log_line_fits_the_schema() {
    let folder = tempfile::tempdir().unwrap();
    let [log, rotated] = ["log", "log.1"].map(|name| folder.path().join(name));
    let server = start(folder.path(), &log);
    client(&server.url, folder.path());
    fs::rename(&log, &rotated).unwrap();
    assert!(Command::new("kill").args(["-HUP", &server.program.id().to_string()]).status().unwrap().success());
    wait_until(|| log.exists());
    client(&server.url, folder.path());
    server.program.terminate().unwrap();
    server.program.finish(PATIENCE).unwrap().success().unwrap();

    let schema = schema();
    let mut seen = BTreeSet::new();
    let mut ended = Vec::new();
    for file in [&rotated, &log] {
        let text = fs::read_to_string(file).unwrap();
        assert!(text.ends_with('\n'));
        for line in text.lines() {
            let entry: Value = serde_json::from_str(line).unwrap_or_else(|error| panic!("{error}: {line}"));
            if let Err(error) = schema.validate(&entry) {
                panic!("{error} at {}: {line}", error.instance_path());
            }
            let message = entry["fields"]["message"].as_str().unwrap_or_default().to_owned();
            if message == "session ended" {
                ended.push(entry.clone());
            }
            // The schema must reject something.
            for broken in [with(&entry, "/level", json!("LOUD")), with(&entry, "/timestamp", json!("yesterday"))] {
                assert!(!schema.is_valid(&broken), "{broken}");
            }
            seen.insert(message);
        }
    }
    for message in [
        "admin address",
        "engine started",
        "warm",
        "listening",
        "session started",
        "sent",
        "rates",
        "session ended",
        "certificate reloaded",
        "draining",
        "stopped",
    ] {
        assert!(seen.contains(message), "no {message:?} among {seen:?}");
    }
    assert_eq!(ended.len(), 2, "a session before the rotation, and one after it");
    for entry in &ended {
        let fields = &entry["fields"];
        let count = |name: &str| fields[name].as_u64().unwrap();
        assert!(
            count("frames_sent") >= 60 && count("bytes") > 0 && fields["gpu_ms"].as_f64().unwrap() > 0.0,
            "{entry}"
        );
        let dropped: u64 = ["superseded", "gated", "unsendable", "abandoned"]
            .iter()
            .map(|cause| count(&format!("frames_{cause}")))
            .sum();
        assert_eq!(count("frames_traced"), count("frames_sent") + dropped, "{entry}");
        let mut short = entry.clone();
        short["fields"].as_object_mut().unwrap().remove("gpu_ms");
        let long = {
            let mut long = entry.clone();
            long["fields"]["mood"] = json!("fine");
            long
        };
        assert!(!schema.is_valid(&short) && !schema.is_valid(&long), "fields are exactly those of the contract");
    }
}

fn with(entry: &Value, place: &str, value: Value) -> Value {
    let mut changed = entry.clone();
    *changed.pointer_mut(place).unwrap() = value;
    changed
}

fn metric_names(text: &str) -> BTreeSet<String> {
    let words = text.split(|c: char| !c.is_ascii_alphanumeric() && c != '_').filter(|word| word.starts_with("gnomon_"));
    words.map(|word| word.trim_end_matches("_bucket").to_owned()).collect()
}

#[test]
fn a_full_disk_does_not_stop_the_server() {
    let folder = tempfile::tempdir().unwrap();
    let server = start(folder.path(), Path::new("/dev/full"));
    let summary = client(&server.url, folder.path());
    assert_eq!(summary["frames_received"], 60, "{summary}");
    let page = metrics(&server.admin);
    assert!(value(&page, "gnomon_log_lines_lost_total") > 60, "{page}");
    assert_eq!(value(&page, "gnomon_sessions_opened_total"), 1);
    // Every metric of alerts and dashboard exists.
    let there = metric_names(&page);
    for file in ["deploy/prometheus/alerts.yml", "deploy/grafana/gnomon.json"] {
        let asked = metric_names(&fs::read_to_string(project(file)).unwrap());
        assert!(asked.len() > 5 && asked.is_subset(&there), "{file} asks for {:?}", asked.difference(&there));
    }
    server.program.terminate().unwrap();
    server.program.finish(PATIENCE).unwrap().success().unwrap();
}

fn reload(server: &Server) {
    assert!(Command::new("kill").args(["-HUP", &server.program.id().to_string()]).status().unwrap().success());
}

#[test]
fn a_log_file_that_cannot_be_reopened_is_a_metric() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("log");
    let server = start(folder.path(), &log);
    let failed = || value(&metrics(&server.admin), "gnomon_reload_failed{what=\"log\"}");
    assert_eq!(failed(), 0);
    fs::rename(&log, folder.path().join("log.1")).unwrap();
    // A FIFO without a reader must not stop the server.
    assert!(Command::new("mkfifo").arg(&log).status().unwrap().success());
    reload(&server);
    wait_until(|| failed() == 1);
    client(&server.url, folder.path());
    fs::remove_file(&log).unwrap();
    reload(&server);
    wait_until(|| failed() == 0);
    server.program.terminate().unwrap();
    server.program.finish(PATIENCE).unwrap().success().unwrap();
    let old = fs::read_to_string(folder.path().join("log.1")).unwrap();
    assert!(old.contains("cannot reopen the log file") && old.contains("session ended"), "the old file is still used");
    assert!(fs::read_to_string(&log).unwrap().contains("stopped"));
}

#[test]
fn a_flood_of_peers_is_few_lines_and_none_goes_uncounted() {
    const PEERS: u64 = 1000;
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("log");
    let server = start_with(folder.path(), &log, &["--transport=lab-tcp"], &[("RUST_LOG", "")]);
    let entries = || {
        let text = fs::read_to_string(&log).unwrap();
        text.lines().map(|line| serde_json::from_str::<Value>(line).unwrap()).collect::<Vec<_>>()
    };
    let said = |entry: &Value, message: &str| entry["fields"]["message"] == message;
    // The transport listens on TCP, too.
    wait_until(|| fs::read_to_string(&log).is_ok_and(|text| text.contains("admin address") && text.ends_with('\n')));
    let first = entries().into_iter().find(|entry| said(entry, "admin address")).unwrap();
    let admin = first["fields"]["local_addr"].as_str().unwrap().to_owned();
    let address = server.url.trim_start_matches("gnomon+lab-tcp://").trim_end_matches('/').to_owned();
    let began = Instant::now();
    for _ in 0..PEERS {
        let mut peer = TcpStream::connect(&address).unwrap();
        // A message of 4 GB.
        peer.write_all(&[0xff; 64]).unwrap();
        let _ = peer.read_to_end(&mut Vec::new());
    }
    let refused = || {
        let page = metrics(&admin);
        let causes = page.lines().filter(|line| line.starts_with("gnomon_refusals_total{"));
        causes.map(|line| line.rsplit_once(' ').unwrap().1.parse::<u64>().unwrap()).sum::<u64>()
    };
    wait_until(|| refused() == PEERS);
    // Peers that are refused before they are heard make no line.
    let heard = value(&metrics(&admin), "gnomon_refusals_total{cause=\"broken\"}");
    server.program.terminate().unwrap();
    server.program.finish(PATIENCE).unwrap().success().unwrap();
    let (schema, entries) = (schema(), entries());
    let logged = entries.iter().filter(|entry| said(entry, "not admitted")).count() as u64;
    let suppressed = entries.iter().filter(|entry| said(entry, "log lines were suppressed"));
    let suppressed: u64 = suppressed.map(|entry| entry["fields"]["lines"].as_u64().unwrap()).sum();
    assert_eq!(logged + suppressed, heard);
    assert!(logged <= 200 + 10 * (began.elapsed().as_secs() + 1), "{logged} lines");
    assert!(entries.iter().all(|entry| schema.is_valid(entry)));
}

/// Set in the process that must panic.
const PANIC: &str = "GNOMON_TEST_PANIC";

#[test]
fn a_panic_is_one_line_of_the_log() {
    const NAME: &str = "a_panic_is_one_line_of_the_log";
    if std::env::var_os(PANIC).is_some() {
        let logs = gnomon_server::logs::init(gnomon_server::config::LogFormat::Json, None).unwrap();
        gnomon_server::logs::log_panics();
        let thread = std::thread::Builder::new().name("unlucky".into());
        let ended = thread.spawn(|| panic!("of {} lines,\n\tand\n\"quotes\"", 3)).unwrap().join();
        assert!(ended.is_err());
        drop(logs);
        return;
    }
    let me = std::env::current_exe().unwrap();
    let ran = Command::new(me).args(["--exact", NAME, "--nocapture"]).env(PANIC, "1").env_remove("RUST_LOG").output();
    let ran = ran.unwrap();
    let said = String::from_utf8(ran.stderr).unwrap();
    assert!(ran.status.success(), "{said}");
    let lines: Vec<&str> = said.lines().collect();
    assert_eq!(lines.len(), 1, "{said}");
    let entry: Value = serde_json::from_str(lines[0]).unwrap();
    assert!(schema().is_valid(&entry), "{entry}");
    assert_eq!(entry["fields"]["message"], "panicked");
    assert_eq!(entry["fields"]["reason"], "of 3 lines, and \"quotes\"");
    assert_eq!(entry["fields"]["thread"], "unlucky");
    assert!(entry["fields"]["place"].as_str().unwrap().contains("telemetry.rs:"), "{entry}");
    assert!(!schema().is_valid(&with(&entry, "/fields/reason", json!("two\nlines"))));
}
