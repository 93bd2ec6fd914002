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

#[test]
fn check_config_shows_what_browsers_pin() {
    let folder = tempfile::tempdir().unwrap();
    let hashes =
        || config(server().arg("--cert-dir").arg(folder.path().join("cert")))["browser_certificate_sha256"].take();
    assert_eq!(hashes(), serde_json::Value::Null, "no server has run");
    let running = start(folder.path());
    let kept = hashes();
    stop(running.child.id(), "-TERM");
    let logs = text(&running.child.wait_with_output().unwrap().stderr);
    let listening = logs.lines().find(|line| line.contains("\"listening\"")).unwrap();
    let fields = &serde_json::from_str::<serde_json::Value>(listening).unwrap()["fields"];
    assert_eq!(kept["current"], fields["browser_certificate_sha256"], "{fields}");
    assert_eq!(kept["next"], fields["next_browser_certificate_sha256"], "{fields}");
    assert_eq!(hashes(), kept, "the next start shows them again");
}

#[cfg(unix)]
#[test]
fn a_certificate_is_replaced_by_one_that_was_announced() {
    let folder = tempfile::tempdir().unwrap();
    let certificate = |action: &str| {
        let output = run(server().args(["certificate", action, "--cert-dir"]).arg(folder.path().join("cert")));
        assert!(output.status.success(), "{}", text(&output.stderr));
        text(&output.stdout).trim_end().to_owned()
    };
    let (first, second) = (certificate("identity"), certificate("spare"));
    let pins = |url: &str| url.trim_end().split_once("/?").unwrap().1.to_owned();
    let running = start(folder.path());
    assert_eq!(pins(&running.url), format!("cert={first}&cert={second}"));
    stop(running.child.id(), "-TERM");
    running.child.wait_with_output().unwrap();
    assert_eq!(certificate("use-spare"), second);
    let running = start(folder.path());
    assert_eq!(pins(&running.url), format!("cert={second}"));
    stop(running.child.id(), "-TERM");
    running.child.wait_with_output().unwrap();
    let output = run(server().args(["certificate", "use-spare", "--cert-dir"]).arg(folder.path().join("cert")));
    let message = text(&output.stderr);
    assert!(message.contains("certificate spare") && message.lines().count() == 1, "{message}");
}

fn stop(id: u32, signal: &str) {
    assert!(Command::new("kill").args([signal, &id.to_string()]).status().unwrap().success());
}

struct Running {
    child: Child,
    url: String,
    rest: BufReader<std::process::ChildStdout>,
}

fn start(folder: &Path) -> Running {
    start_with(folder, |command| {
        command.args(["--listen", "127.0.0.1:0", "--log", "json"]);
    })
}

fn start_with(folder: &Path, change: impl FnOnce(&mut Command)) -> Running {
    let mut command = server();
    command.args(["--backend", "cpu", "--threads", "1", "--scene"]).arg(write_scene(folder).unwrap());
    command.arg("--cert-dir").arg(folder.join("cert")).stdout(Stdio::piped()).stderr(Stdio::piped());
    change(&mut command);
    let mut child = command.spawn().unwrap();
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
        stop(running.child.id(), signal);
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

#[cfg(unix)]
#[test]
fn a_log_that_nobody_reads_is_an_error_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let fifo = folder.path().join("fifo");
    assert!(Command::new("mkfifo").arg(&fifo).status().unwrap().success());
    let scene = write_scene(folder.path()).unwrap();
    for (log, why) in [(fifo.as_path(), "start its reader first"), (folder.path(), "Is a directory")] {
        let output = run(server().arg("--log-file").arg(log).arg("--scene").arg(&scene));
        let message = text(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{message}");
        assert!(message.contains(why) && message.contains(log.to_str().unwrap()), "{message}");
        assert_eq!(message.lines().count(), 1, "{message}");
    }
}

#[test]
fn the_admin_address_can_be_switched_off() {
    let holder = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let folder = tempfile::tempdir().unwrap();
    let taken = holder.local_addr().unwrap().to_string();
    let mut command = server();
    command.args(["--backend", "cpu", "--listen", "127.0.0.1:0", "--admin", &taken, "--scene"]);
    let output = run(command
        .env("RUST_LOG", "off")
        .arg(write_scene(folder.path()).unwrap())
        .arg("--cert-dir")
        .arg(folder.path()));
    let message = text(&output.stderr);
    assert!(message.contains("--admin off") && message.lines().count() == 1, "{message}");
    // As advised; it overrides a variable, too.
    let found = config(server().env("GNOMON_ADMIN", &taken).args(["--admin", "off"]));
    assert_eq!(found["admin"], "off");
}

#[test]
fn a_misspelt_variable_opens_no_server() {
    let output = run(server().env("GNOMON_TOKENS_FILE", "/etc/tokens").args(["--listen", "0.0.0.0:0"]));
    let message = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(message.contains("GNOMON_TOKENS_FILE; did you mean GNOMON_TOKEN_FILE?"), "{message}");
}

#[cfg(unix)]
#[test]
fn a_server_that_admits_everybody_warns_in_plain_text() {
    let folder = tempfile::tempdir().unwrap();
    let mut running = start_with(folder.path(), |command| {
        command.args(["--listen", "0.0.0.0:0", "--advertise", "127.0.0.1", "--log", "pretty"]);
    });
    assert!(Command::new("kill").arg(running.child.id().to_string()).status().unwrap().success());
    let mut rest = String::new();
    running.rest.read_to_string(&mut rest).unwrap();
    let logs = text(&running.child.wait_with_output().unwrap().stderr);
    let warning = logs.lines().find(|line| line.contains("WARN")).unwrap_or_else(|| panic!("no warning in {logs}"));
    assert!(warning.contains("everybody") && warning.contains("--token-file"), "{warning}");
    assert!(!logs.contains('\u{1b}'), "no colour in a pipe: {logs}");
}

#[cfg(target_os = "linux")]
#[test]
fn systemd_is_told_how_the_server_is() {
    use std::time::{Duration, Instant};

    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("notify");
    let socket = std::os::unix::net::UnixDatagram::bind(&path).unwrap();
    socket.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
    let mut running = start_with(folder.path(), |command| {
        command.args(["--listen", "127.0.0.1:0"]).env("NOTIFY_SOCKET", &path).env("WATCHDOG_USEC", "600000");
    });
    let told = || {
        let mut bytes = [0; 1024];
        let length = socket.recv(&mut bytes).unwrap();
        text(&bytes[..length]).trim().to_owned()
    };
    /// Skips the watchdog's messages, which come all the time.
    fn next(told: impl Fn() -> String) -> String {
        loop {
            let message = told();
            if message != "WATCHDOG=1" {
                return message;
            }
        }
    }
    assert_eq!(told(), "READY=1");
    for _ in 0..3 {
        assert_eq!(told(), "WATCHDOG=1");
    }
    let id = running.child.id().to_string();
    let before = Instant::now();
    assert!(Command::new("kill").args(["-HUP", &id]).status().unwrap().success());
    let reloading = next(told);
    let at_us: u64 = reloading.strip_prefix("RELOADING=1\nMONOTONIC_USEC=").unwrap().parse().unwrap();
    assert!(at_us > 0 && before.elapsed() < Duration::from_secs(60), "{reloading}");
    assert_eq!(next(told), "READY=1");
    assert!(Command::new("kill").args(["-TERM", &id]).status().unwrap().success());
    assert_eq!(next(told), "STOPPING=1");
    let mut rest = String::new();
    running.rest.read_to_string(&mut rest).unwrap();
    assert!(running.child.wait().unwrap().success());
}

#[cfg(target_os = "linux")]
#[test]
fn colour_is_for_terminals_that_want_it() {
    let folder = tempfile::tempdir().unwrap();
    let scene = write_scene(folder.path()).unwrap();
    // Logs a line, and ends: there is no such adapter.
    let command = format!(
        "'{}' --scene '{}' --cert-dir '{}' --listen 127.0.0.1:0 --admin 0 --backend compute --adapter nonesuch",
        env!("CARGO_BIN_EXE_gnomon-server"),
        scene.display(),
        folder.path().display()
    );
    let said = |program: &str, arguments: &[&str], variables: &[(&str, &str)]| {
        let mut run = Command::new(program);
        run.args(arguments).stdin(Stdio::null()).env_remove("NO_COLOR").env("TERM", "xterm");
        run.env_remove("RUST_LOG").envs(variables.iter().copied());
        let output = run.output().unwrap();
        let said = text(&output.stdout) + &text(&output.stderr);
        assert!(said.contains("admin address"), "{said}");
        said.contains('\u{1b}')
    };
    let in_terminal = ["-qec", &command, "/dev/null"];
    assert!(said("script", &in_terminal, &[]));
    assert!(said("script", &in_terminal, &[("NO_COLOR", "")]));
    assert!(!said("script", &in_terminal, &[("NO_COLOR", "1")]));
    assert!(!said("script", &in_terminal, &[("TERM", "dumb")]));
    assert!(!said("sh", &["-c", &command], &[]));
}
