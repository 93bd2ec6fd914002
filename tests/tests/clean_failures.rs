//! Promise: a failing program exits with a code other than 0 and prints one line that says what to do.
//!
//! The line must name the cause or the remedy. Logs are off, so that standard error has nothing else.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use std::{
    ffi::OsString,
    fs,
    io::{Read as _, Write as _},
    net::{TcpListener, TcpStream, UdpSocket},
    path::{Path, PathBuf},
    time::Duration,
};

use gnomon_lab::rig::{
    PATIENCE, ServerProcess,
    program::{Outcome, Program, find},
};
use gnomon_protocol::{
    PROTOCOL_VERSION,
    codec::CodecId,
    limits::{MAX_LIGHTS, MAX_SIDE_PX},
    message::{self, ClientMessage, Hello, Refusal, ServerMessage},
};
use gnomon_server::tokens::{self, Scope};
use serde_json::json;

const QUIET: [(&str, &str); 1] = [("RUST_LOG", "off")];

/// A folder with a scene of one floor under `lights` point lights, and a camera path.
struct Stage {
    folder: tempfile::TempDir,
}

impl Stage {
    fn new(lights: u32) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let corners = [[-2.0_f32, 0.0, 2.0], [2.0, 0.0, 2.0], [0.0, 0.0, -3.0]];
        let bytes: Vec<u8> = corners.iter().flatten().flat_map(|value| value.to_le_bytes()).collect();
        fs::write(folder.path().join("floor.bin"), &bytes).unwrap();
        let indices: Vec<_> = (0..lights).collect();
        let nodes: Vec<_> = indices
            .iter()
            .map(|light| {
                json!({
                    "translation": [f64::from(*light) * 0.1, 2.0, 0.0],
                    "extensions": { "KHR_lights_punctual": { "light": light } },
                })
            })
            .chain([json!({ "mesh": 0 })])
            .collect();
        let scene = json!({
            "asset": { "version": "2.0" },
            "extensionsUsed": ["KHR_lights_punctual"],
            "extensions": { "KHR_lights_punctual": { "lights": vec![json!({ "type": "point" }); lights as usize] } },
            "scene": 0,
            "scenes": [{ "nodes": (0..=lights).collect::<Vec<_>>() }],
            "nodes": nodes,
            "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 } }] }],
            "accessors": [{
                "bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3",
                "min": [-2.0, 0.0, -3.0], "max": [2.0, 0.0, 2.0],
            }],
            "bufferViews": [{ "buffer": 0, "byteLength": bytes.len() }],
            "buffers": [{ "uri": "floor.bin", "byteLength": bytes.len() }],
        });
        fs::write(folder.path().join("scene.gltf"), scene.to_string()).unwrap();
        let keyframe = |t: f64| json!({ "t": t, "pos": [0.0, 1.5, 3.0], "target": [0.0, 0.0, 0.0] });
        let path = json!({ "yfov_deg": 60.0, "camera_path": { "keyframes": [keyframe(0.0), keyframe(1.0)] } });
        fs::write(folder.path().join("path.json"), path.to_string()).unwrap();
        Self { folder }
    }

    fn file(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn scene(&self) -> PathBuf {
        self.file("scene.gltf")
    }

    /// Starts a server of this scene on the `cpu` back end.
    fn serve(&self, arguments: &[&str]) -> ServerProcess {
        let mut all = vec!["--backend", "cpu"];
        all.extend(arguments);
        ServerProcess::start(&self.scene(), &all).unwrap()
    }

    /// Returns the error line of a server that fails to start.
    fn server_fails(&self, arguments: &[&str], environment: &[(&str, &str)]) -> String {
        let certificate = self.file("certificate").into_os_string();
        let mut all: Vec<OsString> = vec!["--cert-dir".into(), certificate];
        all.extend(arguments.iter().map(OsString::from));
        let environment: Vec<_> = QUIET.iter().chain(environment).copied().collect();
        let program = Program::start(&find("gnomon-server").unwrap(), &all, &environment).unwrap();
        complaint(&program.finish(PATIENCE).unwrap())
    }

    /// Starts a client that draws two small frames.
    fn client(&self, url: &str, arguments: &[&str], environment: &[(&str, &str)]) -> Outcome {
        let path = self.file("path.json").into_os_string();
        let mut all: Vec<OsString> = vec![url.into(), "--headless".into(), "--path".into(), path];
        all.extend(["--frames", "2", "--wait", "--allow-software"].map(OsString::from));
        if !arguments.contains(&"--size") {
            all.extend(["--size", "64x48"].map(OsString::from));
        }
        all.extend(arguments.iter().map(OsString::from));
        let environment: Vec<_> = QUIET.iter().chain(environment).copied().collect();
        let program = Program::start(&find("gnomon-client").unwrap(), &all, &environment).unwrap();
        program.finish(PATIENCE).unwrap()
    }

    /// Returns the error line of a client that fails.
    fn client_fails(&self, url: &str, arguments: &[&str], environment: &[(&str, &str)]) -> String {
        complaint(&self.client(url, arguments, environment))
    }
}

/// Returns the single line of a failed program.
fn complaint(outcome: &Outcome) -> String {
    let code = outcome.status.code();
    assert!(code.is_some_and(|code| code != 0), "ended with {}:\n{}{}", outcome.status, outcome.stdout, outcome.stderr);
    let lines: Vec<_> = outcome.stderr.lines().filter(|line| !line.trim().is_empty()).collect();
    assert_eq!(lines.len(), 1, "not one line but:\n{}", outcome.stderr);
    assert!(!lines[0].contains("panicked") && !lines[0].contains("RUST_BACKTRACE"), "{}", lines[0]);
    let parts: Vec<_> = lines[0].split(": ").collect();
    assert!(parts.windows(2).all(|pair| pair[0] != pair[1]), "says a thing twice: {}", lines[0]);
    println!("{}", lines[0]);
    lines[0].to_owned()
}

#[track_caller]
fn assert_says(line: &str, words: &[&str]) {
    for word in words {
        assert!(line.to_lowercase().contains(&word.to_lowercase()), "{word:?} is missing from: {line}");
    }
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

#[test]
fn no_scene() {
    let stage = Stage::new(1);
    assert_says(&stage.server_fails(&[], &[]), &["--scene"]);
    let line = stage.server_fails(&["--scene", text(&stage.file("nowhere.glb"))], &[]);
    assert_says(&line, &["nowhere.glb", "no such file"]);
}

#[test]
fn broken_scene() {
    let stage = Stage::new(1);
    fs::write(stage.file("broken.glb"), b"glTF\x02\0\0\0\xff\xff\xff\x7f").unwrap();
    assert_says(&stage.server_fails(&["--scene", text(&stage.file("broken.glb"))], &[]), &["broken.glb"]);
    fs::write(stage.file("floor.bin"), b"short").unwrap();
    let line = stage.server_fails(&["--scene", text(&stage.scene())], &[]);
    assert_says(&line, &["scene.gltf", "buffer 0", "36 bytes", "has 5"]);
}

#[test]
fn too_many_lights_are_served_with_a_warning() {
    let stage = Stage::new(MAX_LIGHTS + 1);
    let mut server = stage.serve(&[]);
    let warned = |said: &str| said.contains("lights beyond the 32 that fit a mask").then_some(());
    server.program().wait_for(PATIENCE, warned).unwrap();
    server.stop().unwrap();
}

#[test]
fn port_taken() {
    let stage = Stage::new(1);
    let scene = stage.scene();
    let udp = UdpSocket::bind("127.0.0.1:0").unwrap();
    let listen = udp.local_addr().unwrap().to_string();
    let line = stage.server_fails(&["--scene", text(&scene), "--backend", "cpu", "--listen", &listen], &[]);
    assert_says(&line, &[&listen, "--listen"]);
    let tcp = TcpListener::bind("127.0.0.1:0").unwrap();
    let listen = tcp.local_addr().unwrap().to_string();
    let arguments = ["--scene", text(&scene), "--backend", "cpu", "--transport", "lab-tcp", "--listen", &listen];
    assert_says(&stage.server_fails(&arguments, &[]), &[&listen, "--listen"]);
}

#[test]
fn no_adapter() {
    let stage = Stage::new(1);
    let scene = stage.scene();
    let compute = ["--scene", text(&scene), "--listen", "127.0.0.1:0", "--backend", "compute", "--allow-software"];
    let no_driver = [("VK_DRIVER_FILES", "/nonexistent/icd.json"), ("VK_ICD_FILENAMES", "/nonexistent/icd.json")];
    assert_says(&stage.server_fails(&compute, &no_driver), &["no graphics adapter", "install"]);
    let mut named = compute.to_vec();
    named.extend(["--adapter", "nosuch"]);
    assert_says(&stage.server_fails(&named, &[]), &["nosuch", "found"]);
    // A software adapter is refused unless allowed.
    let mut software = compute[..6].to_vec();
    // By name, for machines that also have a GPU.
    software.extend(["--adapter", "llvmpipe"]);
    assert_says(&stage.server_fails(&software, &[]), &["software", "--allow-software"]);
    let server = stage.serve(&[]);
    assert_says(&stage.client_fails(server.url(), &[], &no_driver), &["no graphics adapter", "install"]);
    assert_says(&stage.client_fails(server.url(), &["--adapter", "nosuch"], &[]), &["nosuch", "found"]);
    server.stop().unwrap();
}

#[test]
fn server_unreachable() {
    let stage = Stage::new(1);
    // A port without a server.
    let silent = UdpSocket::bind("127.0.0.1:0").unwrap();
    let address = silent.local_addr().unwrap();
    let quic = format!("gnomon://{address}/?cert={}", "ab".repeat(32));
    assert_says(&stage.client_fails(&quic, &[], &[]), &[&address.to_string(), "is gnomon-server running there"]);
    // A port that was free a moment ago.
    let address = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    for scheme in ["gnomon+lab-udp", "gnomon+lab-tcp"] {
        let line = stage.client_fails(&format!("{scheme}://{address}/"), &[], &[]);
        assert_says(&line, &[&address.to_string(), "is gnomon-server running there"]);
    }
    assert_says(&stage.client_fails("http://127.0.0.1/", &[], &[]), &["gnomon://"]);
}

#[test]
fn wrong_certificate() {
    let stage = Stage::new(1);
    let server = stage.serve(&[]);
    let (address, certificate) = server.url().split_once("cert=").unwrap();
    let digit = if certificate.starts_with('0') { "1" } else { "0" };
    let wrong = format!("{address}cert={digit}{}", &certificate[1..]);
    assert_says(&stage.client_fails(&wrong, &[], &[]), &["another certificate", "use the URL that the server printed"]);
    assert_says(&stage.client_fails(&format!("{address}cert=abc"), &[], &[]), &["cert"]);
    // With the right certificate the same client is served.
    stage.client(server.url(), &[], &[]).success().unwrap();
    server.stop().unwrap();
}

#[test]
fn wrong_token() {
    let stage = Stage::new(1);
    let (ours, entry) = tokens::make("ours", None, &[Scope::Session], false).unwrap();
    fs::write(stage.file("tokens"), &entry).unwrap();
    let server = stage.serve(&["--token-file", text(&stage.file("tokens"))]);
    for arguments in [&[][..], &["--token", &ours[..63]], &["--token", "ours"]] {
        assert_says(&stage.client_fails(server.url(), arguments, &[]), &["token", "--token"]);
    }
    stage.client(server.url(), &["--token", &ours], &[]).success().unwrap();
    server.stop().unwrap();
}

/// Sends one control message over TCP and reads one answer.
fn exchange(stream: &mut TcpStream, hello: &Hello) -> ServerMessage {
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    stream.write_all(&message::encode(&ClientMessage::Hello(hello.clone())).unwrap()).unwrap();
    message::decode(&read_message(stream)).unwrap()
}

fn read_message(stream: &mut TcpStream) -> Vec<u8> {
    let mut prefix = [0; 4];
    stream.read_exact(&mut prefix).unwrap();
    let mut bytes = vec![0; message::decode_length(prefix).unwrap()];
    stream.read_exact(&mut bytes).unwrap();
    bytes
}

fn address_of(url: &str) -> String {
    url.split_once("://").unwrap().1.trim_end_matches('/').split('/').next().unwrap().to_owned()
}

fn hello() -> Hello {
    Hello {
        version: PROTOCOL_VERSION,
        token: None,
        client: "a test".into(),
        width: 64,
        height: 48,
        codec: CodecId::PlanesLz4,
        rate_hz: 0,
        wrong_ppm: 0,
        resume: None,
    }
}

#[test]
fn version_mismatch() {
    let stage = Stage::new(1);
    // A newer client at today's server.
    let server = stage.serve(&["--transport", "lab-tcp"]);
    let tomorrow = PROTOCOL_VERSION + 1;
    let mut stream = TcpStream::connect(address_of(server.url())).unwrap();
    let answer = exchange(&mut stream, &Hello { version: tomorrow, ..hello() });
    let expected = Refusal::Version { server: PROTOCOL_VERSION, client: tomorrow };
    assert_eq!(answer, ServerMessage::Refused(expected));
    let welcome = exchange(&mut TcpStream::connect(address_of(server.url())).unwrap(), &hello());
    assert!(matches!(welcome, ServerMessage::Welcome(_)), "{welcome:?}");
    server.stop().unwrap();
    // Today's client at a newer server.
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let url = format!("gnomon+lab-tcp://{}/", listener.local_addr().unwrap());
    let server = std::thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
        let message: ClientMessage = message::decode(&read_message(&mut stream)).unwrap();
        assert!(matches!(message, ClientMessage::Hello(Hello { version: PROTOCOL_VERSION, .. })), "{message:?}");
        let refusal = Refusal::Version { server: tomorrow, client: PROTOCOL_VERSION };
        stream.write_all(&message::encode(&ServerMessage::Refused(refusal)).unwrap()).unwrap();
        // Held open until the client has read it and left.
        drop(stream.read(&mut [0]));
    });
    let line = stage.client_fails(&url, &[], &[]);
    assert_says(&line, &[&format!("version {tomorrow}"), &PROTOCOL_VERSION.to_string(), "install matching versions"]);
    server.join().unwrap();
}

#[test]
fn size_zero_or_above_the_limit() {
    let stage = Stage::new(1);
    let server = stage.serve(&["--transport", "lab-tcp"]);
    let above = format!("{}x8", MAX_SIDE_PX + 1);
    for size in ["0x0", "64x0", "4096x4096", "65535x65535", &above] {
        let line = stage.client_fails(server.url(), &["--size", size], &[]);
        assert_says(&line, &["size"]);
    }
    // The server must refuse these sizes even from clients that do not check them.
    for (width, height) in [(0, 0), (64, 0), (MAX_SIDE_PX + 1, 8), (4096, 4096), (u32::MAX, u32::MAX)] {
        let mut stream = TcpStream::connect(address_of(server.url())).unwrap();
        let answer = exchange(&mut stream, &Hello { width, height, ..hello() });
        let ServerMessage::Refused(Refusal::Unsupported(reason)) = answer else { panic!("{answer:?}") };
        assert!(reason.to_string().contains(&width.to_string()), "{reason}");
    }
    server.stop().unwrap();
}

#[test]
fn disk_full_while_writing_pictures() {
    let stage = Stage::new(1);
    let server = stage.serve(&[]);
    let out = stage.file("pictures");
    stage.client(server.url(), &["--out", text(&out)], &[]).success().unwrap();
    let pictures: Vec<_> = fs::read_dir(&out).unwrap().map(|entry| entry.unwrap().path()).collect();
    assert_eq!(pictures.len(), 2, "{pictures:?}");
    // Writes to /dev/full fail as on a full disk (ENOSPC), even for root.
    for picture in &pictures {
        fs::remove_file(picture).unwrap();
        std::os::unix::fs::symlink("/dev/full", picture).unwrap();
    }
    let line = stage.client_fails(server.url(), &["--out", text(&out)], &[]);
    assert_says(&line, &["no space left", text(&out)]);
    for flag in ["--summary", "--stats"] {
        let line = stage.client_fails(server.url(), &[flag, "/dev/full"], &[]);
        assert_says(&line, &["no space left", "/dev/full"]);
    }
    server.stop().unwrap();
}
