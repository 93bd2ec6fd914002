//! A WebTransport client, as in a browser: same port and session, different certificate.

use gnomon_protocol::message::ClientMessage;
use web_transport_quinn::ClientBuilder;

use super::{
    Rig,
    client::{Control, Frames, hello, pose_packet},
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
