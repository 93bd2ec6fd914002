//! A WebTransport client, as in a browser: same port and session, different certificate.

use std::net::SocketAddr;

use gnomon_protocol::message::ClientMessage;
use rcgen::{CertificateParams, KeyPair};
use rustls::pki_types::{CertificateDer, pem::PemObject as _};
use web_transport_quinn::{Client, ClientBuilder, ClientError, Session, proto::ConnectRequest};

use super::{
    Rig,
    client::{Control, Frames, Native, client_config, hello, pose_packet},
    operator::{self, value},
    soon,
};

fn bytes_of(hex: &str) -> Vec<u8> {
    (0..hex.len()).step_by(2).map(|at| u8::from_str_radix(&hex[at..at + 2], 16).unwrap()).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_browser_gets_frames_too() {
    let rig = Rig::start(|_, _| {}).await;
    let hash = rig.server.browser_certificate_sha256().unwrap();
    assert!(!rig.server.url().contains(&hash), "browsers refuse the certificate that is kept");
    let client = ClientBuilder::new().with_server_certificate_hashes(vec![bytes_of(&hash)]).unwrap();
    let url = url::Url::parse(&format!("https://{}/", rig.address())).unwrap();
    let session = soon(client.connect(url)).await.unwrap();
    let (send, receive) = session.open_bi().await.unwrap();
    let mut control = Control::new(receive, send);
    let welcome = control.welcome(hello()).await;
    let packed = control.fetch(&welcome, 0).await;
    assert_eq!(packed.len() as u64, welcome.scene_bytes);
    control.send(&ClientMessage::Start).await;
    let mut frames = Frames::new();
    let mask = soon(async {
        for sequence in 0.. {
            session.send_datagram(pose_packet(sequence, 3).into()).unwrap();
            let patience = std::time::Duration::from_millis(500);
            while let Ok(datagram) = tokio::time::timeout(patience, session.read_datagram()).await {
                if let Some((3, mask)) = frames.push(&datagram.unwrap()) {
                    return mask;
                }
            }
        }
        unreachable!("numbers do not end")
    })
    .await;
    assert!(mask.words().iter().any(|word| *word != 0));
    session.close(0, b"bye");
    rig.sessions(0).await;
}

/// Connects as a page of this origin.
async fn from_origin(client: &Client, address: SocketAddr, origin: Option<&str>) -> Result<Session, ClientError> {
    let mut request = ConnectRequest::new(url::Url::parse(&format!("https://{address}/")).unwrap());
    if let Some(origin) = origin {
        request = request.with_header("origin".parse().unwrap(), origin.parse().unwrap());
    }
    soon(client.connect(request)).await
}

fn pinning(rig: &Rig) -> Client {
    let hash = rig.server.browser_certificate_sha256().unwrap();
    ClientBuilder::new().with_server_certificate_hashes(vec![bytes_of(&hash)]).unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn only_pages_of_listed_origins_connect() {
    let rig = Rig::start(|config, _| {
        config.origins = Some("https://a.example,https://b.example:8443".parse().unwrap());
        config.admin = Some("127.0.0.1:0".parse().unwrap());
    })
    .await;
    let client = pinning(&rig);
    let long = format!("https://{}.example", "x".repeat(4000));
    let refused = [None, Some("null"), Some("https://evil.example"), Some("http://a.example"), Some(&*long)];
    for origin in refused {
        let connected = from_origin(&client, rig.address(), origin).await.map(drop);
        assert!(connected.is_err_and(|error| error.to_string().contains("403")), "{origin:?}");
    }
    for origin in ["https://a.example", "https://b.example:8443"] {
        let session = from_origin(&client, rig.address(), Some(origin)).await.unwrap();
        let (send, receive) = session.open_bi().await.unwrap();
        Control::new(receive, send).welcome(hello()).await;
    }
    // Programs have no origin, and need none.
    Native::started(rig.address(), rig.folder.path()).await;
    let page = operator::page(&rig).await;
    assert_eq!(value(&page, "gnomon_refusals_total{cause=\"origin\"}"), refused.len() as u64, "{page}");
    assert_eq!(value(&page, "gnomon_refusals_total{cause=\"broken\"}"), 0, "{page}");
}

#[tokio::test(flavor = "multi_thread")]
async fn every_origin_connects_without_a_list() {
    let rig = Rig::start(|_, _| {}).await;
    for origin in [None, Some("null"), Some("https://a.example")] {
        from_origin(&pinning(&rig), rig.address(), origin).await.unwrap();
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn browsers_are_shown_the_operators_certificate_and_its_successor() {
    let write = |folder: &std::path::Path| {
        let key = KeyPair::generate().unwrap();
        let certificate = CertificateParams::new(["127.0.0.1".to_owned()]).unwrap().self_signed(&key).unwrap();
        std::fs::write(folder.join("chain.pem"), certificate.pem()).unwrap();
        std::fs::write(folder.join("key.pem"), key.serialize_pem()).unwrap();
        CertificateDer::from_pem_file(folder.join("chain.pem")).unwrap()
    };
    let mut first = None;
    let rig = Rig::start(|config, folder| {
        first = Some(write(folder));
        (config.cert_file, config.key_file) = (Some(folder.join("chain.pem")), Some(folder.join("key.pem")));
    })
    .await;
    assert_eq!(rig.server.browser_certificate_sha256(), None, "there is nothing to pin");
    let trusting = |certificate: &CertificateDer<'static>| {
        let endpoint = quinn::Endpoint::client("127.0.0.1:0".parse().unwrap()).unwrap();
        Client::new(endpoint, client_config(certificate, b"h3"))
    };
    let first = first.unwrap();
    from_origin(&trusting(&first), rig.address(), None).await.unwrap();
    let second = write(rig.folder.path());
    assert!(from_origin(&trusting(&second), rig.address(), None).await.is_err());
    rig.server.reload();
    from_origin(&trusting(&second), rig.address(), None).await.unwrap();
    assert!(from_origin(&trusting(&first), rig.address(), None).await.is_err());
}
