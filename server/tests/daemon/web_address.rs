//! The web address: what a page asks before it connects.

use std::{net::SocketAddr, sync::Arc, time::Duration};

use gnomon_protocol::PROTOCOL_VERSION;
use gnomon_server::{Server, error::StartError, limits::MAX_WEB_CONNECTIONS};
use rcgen::{CertificateParams, KeyPair};
use rustls::pki_types::{CertificateDer, ServerName, pem::PemObject as _};
use serde_json::{Value, json};
use tokio::{
    io::{AsyncRead, AsyncReadExt as _, AsyncWrite, AsyncWriteExt as _},
    net::TcpStream,
};
use tokio_rustls::TlsConnector;

use super::{Rig, config, soon};

const GET: &str = "GET /gnomon.json HTTP/1.1\r\nHost: edge\r\nOrigin: https://a.example\r\nConnection: close\r\n\r\n";

fn get(path: &str) -> String {
    format!("GET {path} HTTP/1.1\r\nHost: edge\r\nAccept-Encoding: gzip\r\nConnection: close\r\n\r\n")
}

/// Returns everything that the server answers until it closes.
async fn ask(mut stream: impl AsyncRead + AsyncWrite + Unpin, request: &str) -> String {
    let mut answer = String::new();
    // The server may close before it has read all.
    let _ = stream.write_all(request.as_bytes()).await;
    let _ = soon(stream.read_to_string(&mut answer)).await;
    answer
}

async fn ask_plain(web: SocketAddr, request: &str) -> String {
    ask(TcpStream::connect(web).await.unwrap(), request).await
}

fn json_of(answer: &str) -> Value {
    serde_json::from_str(answer.split_once("\r\n\r\n").unwrap_or_else(|| panic!("no answer: {answer:?}")).1).unwrap()
}

async fn with_web() -> (Rig, SocketAddr) {
    let rig = Rig::start(|config, _| config.web = Some("127.0.0.1:0".parse().unwrap())).await;
    let web = rig.server.web_addr().unwrap();
    (rig, web)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_page_finds_port_and_hashes() {
    let (rig, web) = with_web().await;
    let answer = ask_plain(web, GET).await;
    assert!(answer.starts_with("HTTP/1.1 200 OK\r\n"), "{answer}");
    assert!(answer.contains("access-control-allow-origin: *\r\n"), "{answer}");
    let page = json_of(&answer);
    assert_eq!(page["port"], rig.address().port());
    assert_eq!(page["protocol_version"], PROTOCOL_VERSION);
    assert_eq!(page["scene"], "scene");
    assert_eq!(page["certificate_sha256"]["current"], rig.server.browser_certificate_sha256().unwrap());
    assert_eq!(page["certificate_sha256"]["next"].as_str().unwrap().len(), 64);
    assert!(ask_plain(web, &get("/")).await.starts_with("HTTP/1.1 404"), "there is no page");
    rig.server.shutdown().await;
    assert!(TcpStream::connect(web).await.is_err(), "it closes with the server");
}

#[tokio::test(flavor = "multi_thread")]
async fn the_page_comes_from_a_folder() {
    let root = tempfile::tempdir().unwrap();
    let wasm = vec![b'w'; 3 << 20];
    for (name, bytes) in [
        ("index.html", &b"<script type=module src=assets/page.js></script>"[..]),
        ("page.js", b"plain"),
        ("page.js.gz", b"compressed"),
        ("gnomon_web_bg.wasm", &wasm),
    ] {
        std::fs::write(root.path().join(name), bytes).unwrap();
    }
    let rig = Rig::start(|config, _| {
        config.web = Some("127.0.0.1:0".parse().unwrap());
        config.web_root = Some(root.path().to_owned());
    })
    .await;
    let web = rig.server.web_addr().unwrap();
    let index = ask_plain(web, &get("/")).await;
    assert!(index.starts_with("HTTP/1.1 200 OK\r\n") && index.contains("content-type: text/html"), "{index}");
    let port = rig.address().port();
    let policy = index.lines().find_map(|line| line.strip_prefix("content-security-policy: ")).unwrap();
    assert!(policy.contains(&format!("connect-src 'self' https://edge:{port};")), "{policy}");
    assert!(policy.contains("default-src 'none'; script-src 'self' 'wasm-unsafe-eval';"), "{policy}");
    let path = index.split_once("src=").unwrap().1.split_once('>').unwrap().0;
    let script = ask_plain(web, &get(&format!("/{path}"))).await;
    assert!(script.contains("content-encoding: gzip\r\n") && script.ends_with("compressed"), "{script}");
    assert!(script.contains("immutable"), "{script}");
    let wasm_path = path.replace("page.js", "gnomon_web_bg.wasm");
    let answer = ask_plain(web, &get(&format!("/{wasm_path}"))).await;
    assert!(answer.contains("content-type: application/wasm\r\n") && answer.len() > wasm.len());
    let head = ask_plain(web, &get(&format!("/{wasm_path}")).replace("GET", "HEAD")).await;
    assert!(head.contains(&format!("content-length: {}\r\n", wasm.len())) && head.ends_with("\r\n\r\n"), "{head}");
    assert_eq!(json_of(&ask_plain(web, GET).await)["scene"], "scene");
    assert!(ask_plain(web, &get("/../Cargo.toml")).await.starts_with("HTTP/1.1 404"));
}

#[tokio::test(flavor = "multi_thread")]
async fn beyond_loopback_it_speaks_tls_with_the_operators_certificate() {
    let mut certificate = None;
    let rig = Rig::start(|config, folder| {
        let key = KeyPair::generate().unwrap();
        let made = CertificateParams::new(["127.0.0.1".to_owned()]).unwrap().self_signed(&key).unwrap();
        let [chain_file, key_file] = ["chain.pem", "key.pem"].map(|name| folder.join(name));
        std::fs::write(&chain_file, made.pem()).unwrap();
        std::fs::write(&key_file, key.serialize_pem()).unwrap();
        certificate = Some(CertificateDer::from_pem_file(&chain_file).unwrap());
        (config.cert_file, config.key_file) = (Some(chain_file), Some(key_file));
        config.web = Some("0.0.0.0:0".parse().unwrap());
        config.advertise = Some("edge.example:443".to_owned());
    })
    .await;
    let web = SocketAddr::from(([127, 0, 0, 1], rig.server.web_addr().unwrap().port()));
    let mut roots = rustls::RootCertStore::empty();
    roots.add(certificate.unwrap()).unwrap();
    let tls = rustls::ClientConfig::builder_with_provider(Arc::new(rustls::crypto::ring::default_provider()))
        .with_safe_default_protocol_versions()
        .unwrap()
        .with_root_certificates(roots)
        .with_no_client_auth();
    let stream = TcpStream::connect(web).await.unwrap();
    let name = ServerName::try_from("127.0.0.1").unwrap();
    let stream = TlsConnector::from(Arc::new(tls)).connect(name, stream).await.unwrap();
    let page = json_of(&ask(stream, GET).await);
    let expected = json!({
        "port": 443,
        "protocol_version": PROTOCOL_VERSION,
        "scene": "scene",
        "certificate_sha256": null,
        "origins": null,
        "websocket": "/session",
    });
    assert_eq!(page, expected);
    assert!(!ask_plain(web, GET).await.contains("200 OK"), "nothing in the clear");
}

#[tokio::test(flavor = "multi_thread")]
async fn idle_and_broken_peers_take_seats_for_seconds_only() {
    let (_rig, web) = with_web().await;
    let mut garbage = TcpStream::connect(web).await.unwrap();
    garbage.write_all(&[0xff; 70_000]).await.unwrap();
    let mut idle = Vec::new();
    for _ in 0..MAX_WEB_CONNECTIONS {
        idle.push(TcpStream::connect(web).await.unwrap());
    }
    soon(async {
        while !ask_plain(web, GET).await.starts_with("HTTP/1.1 200") {
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
    })
    .await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_taken_or_open_web_address_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let holder = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let taken = holder.local_addr().unwrap().to_string();
    for (address, part) in [(&*taken, &*format!("{taken}: ")), ("0.0.0.0:0", "--cert-file")] {
        let mut config = config(folder.path());
        config.web = Some(address.parse().unwrap());
        let error: StartError = Server::start(config).await.map(|server| server.url()).unwrap_err();
        assert!(error.to_string().contains(part) && error.to_string().contains("--web"), "{error}");
    }
    let mut config = config(folder.path());
    (config.web, config.web_root) = (Some("127.0.0.1:0".parse().unwrap()), Some(folder.path().join("nowhere")));
    let error = Server::start(config).await.map(|server| server.url()).unwrap_err().to_string();
    assert!(error.contains("--web-root") && error.contains("nowhere"), "{error}");
}
