//! What a client says of a QUIC server that is not the one it looks for, speaks another version, or writes into its
//! terminal.

#![allow(clippy::unwrap_used, reason = "helpers outside the test functions use it too")]

use std::{net::SocketAddr, sync::Arc, time::Duration};

use gnomon_client::{
    ClientError,
    app::probe::{ProbeOptions, run_probe},
    camera_path::{CameraPath, PathSpec},
};
use gnomon_protocol::codec::CodecId;
use quinn::crypto::rustls::QuicServerConfig;
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
use tokio::runtime::Runtime;

const HOSTILE: &[u8] = b"bye\x1b[2J\x1b]0;owned\x07\r\n2026-01-01 ERROR forged \xe2\x80\xae";

/// A server that shows its certificate and then closes every connection with the reason [`HOSTILE`].
struct Closer {
    address: SocketAddr,
    sha256: String,
    runtime: Runtime,
}

impl Closer {
    fn start(alpn: &[u8]) -> Self {
        let made = rcgen::generate_simple_self_signed(["gnomon".to_owned()]).unwrap();
        let certificate: CertificateDer<'static> = made.cert.der().clone();
        let key = PrivateKeyDer::try_from(made.signing_key.serialize_der()).unwrap();
        let provider = Arc::new(rustls::crypto::ring::default_provider());
        let suite = rustls::crypto::ring::cipher_suite::TLS13_AES_128_GCM_SHA256.tls13().unwrap();
        let sha256 = suite.common.hash_provider.hash(&certificate);
        let sha256 = sha256.as_ref().iter().map(|byte| format!("{byte:02x}")).collect();
        let mut tls = rustls::ServerConfig::builder_with_provider(provider)
            .with_protocol_versions(&[&rustls::version::TLS13])
            .unwrap()
            .with_no_client_auth()
            .with_single_cert(vec![certificate], key)
            .unwrap();
        tls.alpn_protocols = vec![alpn.to_vec()];
        let config = quinn::ServerConfig::with_crypto(Arc::new(QuicServerConfig::try_from(tls).unwrap()));
        let runtime = Runtime::new().unwrap();
        let _entered = runtime.enter();
        let endpoint = quinn::Endpoint::server(config, "127.0.0.1:0".parse().unwrap()).unwrap();
        let address = endpoint.local_addr().unwrap();
        runtime.spawn(async move {
            while let Some(incoming) = endpoint.accept().await {
                if let Ok(connection) = incoming.await {
                    connection.close(7_u32.into(), HOSTILE);
                }
            }
        });
        Self { address, sha256, runtime }
    }

    /// Returns what a client with these certificates in its URL says.
    fn refuses(&self, certificates: &[&str]) -> ClientError {
        let query: Vec<_> = certificates.iter().map(|certificate| format!("cert={certificate}")).collect();
        let options = ProbeOptions {
            url: format!("gnomon://{}/?{}", self.address, query.join("&")).parse().unwrap(),
            token: None,
            width: 8,
            height: 8,
            codec: CodecId::PlanesLz4,
            frames: 1,
            fps: None,
            start_time_s: 0.0,
            connect_timeout: Duration::from_secs(20),
        };
        run_probe(self.runtime.handle(), &options, &path()).unwrap_err()
    }
}

fn path() -> CameraPath {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("path.json");
    let keyframe = |t: f64| serde_json::json!({ "t": t, "pos": [0.0, 2.5, 0.5], "target": [0.0, 0.0, 0.0] });
    let path = serde_json::json!({ "yfov_deg": 60.0, "camera_path": { "keyframes": [keyframe(0.0), keyframe(1.0)] } });
    std::fs::write(&file, path.to_string()).unwrap();
    file.display().to_string().parse::<PathSpec>().unwrap().load().unwrap()
}

#[test]
fn any_of_the_named_certificates_is_accepted_and_no_other() {
    let server = Closer::start(b"gnomon/1");
    let other = "ab".repeat(32);
    assert!(matches!(server.refuses(&[&other]), ClientError::Certificate(_)));
    assert!(matches!(server.refuses(&[&other, &"cd".repeat(32)]), ClientError::Certificate(_)));
    for certificates in [&[server.sha256.as_str()][..], &[&other, &server.sha256]] {
        let error = server.refuses(certificates);
        assert!(error.to_string().contains("bye"), "admitted by certificate, and closed by the server: {error}");
    }
}

#[test]
fn what_a_server_writes_into_its_close_reason_stays_text() {
    let server = Closer::start(b"gnomon/1");
    let error = server.refuses(&[&server.sha256]);
    let shown = r"bye\u{1b}[2J\u{1b}]0;owned\u{7}\r\n2026-01-01 ERROR forged \u{202e}";
    for said in [error.to_string(), format!("{error:?}")] {
        assert!(!said.contains(char::is_control) && !said.contains('\u{202e}'), "{said:?}");
    }
    assert!(error.to_string().contains(shown), "{error}");
}

#[test]
fn a_server_of_another_version_is_named_as_such() {
    let server = Closer::start(b"gnomon/0");
    let error = server.refuses(&[&server.sha256]);
    assert!(matches!(error, ClientError::OtherVersion(_)), "{error:?}");
    assert!(error.to_string().contains("install matching versions"), "{error}");
}
