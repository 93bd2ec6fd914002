//! The binary: flags, environment, file, exit codes, standard output, and signals.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use std::{
    io::{BufRead as _, BufReader, Read as _},
    path::Path,
    process::{Child, Command, Output, Stdio},
};

use gnomon_scene::testing::write_scene;

fn server() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_gnomon-server"));
    for (name, _) in std::env::vars_os() {
        if name.to_string_lossy().starts_with("GNOMON_") {
            command.env_remove(name);
        }
    }
    command.stdin(Stdio::null());
    command
}

/// Runs the command to its end. Stops a server that starts unexpectedly.
fn run(command: &mut Command) -> Output {
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut line = String::new();
    let mut out = BufReader::new(child.stdout.take().unwrap());
    out.read_line(&mut line).unwrap();
    assert!(!line.starts_with("gnomon"), "it has started: {}", {
        child.kill().unwrap();
        line
    });
    let mut stdout = line.into_bytes();
    out.read_to_end(&mut stdout).unwrap();
    Output { stdout, ..child.wait_with_output().unwrap() }
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

fn config(command: &mut Command) -> serde_json::Value {
    let output = run(command.arg("--check-config"));
    assert!(output.status.success(), "{}", text(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

#[test]
fn flags_beat_the_environment_which_beats_the_file_which_beats_the_defaults() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("gnomon.toml");
    std::fs::write(&file, "max_sessions = 2\ndrain_ms = 20\nidle_timeout_ms = 2000\n").unwrap();
    let default = config(&mut server());
    assert_eq!((default["max_sessions"].as_u64(), default["drain_ms"].as_u64()), (Some(64), Some(1000)));
    let all = config(
        server()
            .env("GNOMON_CONFIG", &file)
            .env("GNOMON_DRAIN_MS", "30")
            .env("GNOMON_IDLE_TIMEOUT_MS", "3000")
            .env("GNOMON_ALLOW_SOFTWARE", "true")
            .args(["--idle-timeout-ms", "4000"]),
    );
    assert_eq!(all["max_sessions"], 2, "from the file");
    assert_eq!(all["drain_ms"], 30, "from the environment");
    assert_eq!(all["idle_timeout_ms"], 4000, "from the flag");
    assert_eq!(all["allow_software"], true, "from the environment");
    assert_eq!(all["handshake_timeout_ms"], default["handshake_timeout_ms"]);
    let sources = ["max_sessions", "drain_ms", "idle_timeout_ms", "handshake_timeout_ms"];
    assert_eq!(
        sources.map(|key| all["sources"][key].as_str().unwrap()),
        ["file", "GNOMON_DRAIN_MS", "flag", "default"]
    );
}

#[test]
fn every_failure_is_one_line_with_a_remedy() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str, content: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, content).unwrap();
        path.to_str().unwrap().to_owned()
    };
    let good = write_scene(folder.path()).unwrap().to_str().unwrap().to_owned();
    let broken = path("broken.gltf", "{\"asset\": {\"version\": \"2.0\"}, \"meshes\": 7}");
    let unknown_key = path("unknown.toml", "max_session = 3\n");
    let bad_tokens = path("tokens", "a-bare-token\n");
    let in_the_way = path("file", "");
    for (arguments, part) in [
        (vec![], "--scene FILE"),
        (vec!["--scene", "/nowhere.glb"], "/nowhere.glb"),
        (vec!["--scene", &broken], "broken.gltf"),
        (vec!["--scene", &broken, "--check"], "broken.gltf"),
        (vec!["--config", &unknown_key], "line 1: unknown key \"max_session\"; did you mean max_sessions?"),
        (vec!["--config", "/nowhere.toml"], "/nowhere.toml"),
        (vec!["--scene", &good, "--token-file", &bad_tokens], "tokens: line 1"),
        (vec!["--scene", &good, "--cert-dir", &in_the_way], "--cert-dir"),
        (vec!["--scene", &good, "--listen", "127.0.0.1:1", "--transport", "lab-tcp", "--lights", "33"], "1 to 32"),
        (vec!["--scene", &good, "--listen", "0.0.0.0:0", "--transport", "lab-udp"], "loopback only"),
        (
            vec!["--scene", &good, "--listen", "127.0.0.1:0", "--backend", "compute", "--adapter", "no such adapter"],
            "no such adapter",
        ),
        (vec!["--max-sessions", "0"], "--max-sessions 0: must be 1 to 4096"),
    ] {
        let cert_dir = folder.path().join("cert");
        let mut command = server();
        // Mesa complains on standard error without this folder.
        command.env("XDG_RUNTIME_DIR", folder.path());
        let output = run(command.env("GNOMON_CERT_DIR", cert_dir).env("RUST_LOG", "off").args(&arguments));
        let message = text(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{arguments:?}: {message}");
        assert!(output.stdout.is_empty(), "{arguments:?}");
        assert!(message.contains(part) && message.lines().count() == 1, "{arguments:?}: {message}");
    }
}

#[test]
fn a_taken_port_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let scene = write_scene(folder.path()).unwrap();
    let holder = std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
    let address = holder.local_addr().unwrap().to_string();
    let output = run(server()
        .env("RUST_LOG", "off")
        .args(["--backend", "cpu", "--listen", &address, "--scene"])
        .arg(scene)
        .arg("--cert-dir")
        .arg(folder.path()));
    let message = text(&output.stderr);
    assert!(!output.status.success());
    assert!(message.contains(&format!("{address} is taken")) && message.lines().count() == 1, "{message}");
}

#[test]
fn check_describes_the_scene() {
    let folder = tempfile::tempdir().unwrap();
    let output = run(server().arg("--check").arg("--scene").arg(write_scene(folder.path()).unwrap()));
    let found = text(&output.stdout);
    assert!(output.status.success(), "{}", text(&output.stderr));
    for part in ["triangles", "instances", "materials", "lights", "bounds", "memory", "digest", "everybody is admitted"]
    {
        assert!(found.contains(part), "no {part} in {found}");
    }
}

struct Running {
    child: Child,
    url: String,
    rest: BufReader<std::process::ChildStdout>,
}

fn start(folder: &Path) -> Running {
    let mut child = server()
        .args(["--listen", "127.0.0.1:0", "--backend", "cpu", "--threads", "1", "--log", "json", "--scene"])
        .arg(write_scene(folder).unwrap())
        .arg("--cert-dir")
        .arg(folder.join("cert"))
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut rest = BufReader::new(child.stdout.take().unwrap());
    let mut url = String::new();
    rest.read_line(&mut url).unwrap();
    Running { child, url, rest }
}

#[cfg(unix)]
#[test]
fn it_prints_one_line_keeps_its_certificate_and_stops_on_a_signal() {
    let folder = tempfile::tempdir().unwrap();
    let mut pins = Vec::new();
    for signal in ["-TERM", "-INT"] {
        let mut running = start(folder.path());
        let (authority, pin) = running.url.trim_end().split_once("/?cert=").unwrap();
        let port: u16 = authority.strip_prefix("gnomon://127.0.0.1:").unwrap().parse().unwrap();
        assert_ne!(port, 0);
        assert!(pin.len() == 64 && pin.bytes().all(|byte| byte.is_ascii_hexdigit()), "{pin}");
        pins.push(pin.to_owned());
        let id = running.child.id().to_string();
        assert!(Command::new("kill").args([signal, &id]).status().unwrap().success());
        let mut rest = String::new();
        running.rest.read_to_string(&mut rest).unwrap();
        assert_eq!(rest, "", "one line on standard output");
        let output = running.child.wait_with_output().unwrap();
        let logs = text(&output.stderr);
        assert_eq!(output.status.code(), Some(0), "{logs}");
        for line in logs.lines() {
            let entry: serde_json::Value = serde_json::from_str(line).unwrap();
            assert!(entry["level"].is_string() && entry["fields"]["message"].is_string(), "{line}");
        }
        assert!(logs.contains("\"listening\"") && logs.contains("\"stopped\""), "{logs}");
    }
    assert_eq!(pins[0], pins[1], "clients that pinned the first start trust the second");
}
