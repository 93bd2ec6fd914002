//! Masks are coded only against masks that the client acknowledged.

use gnomon_protocol::{
    acknowledgement::Acknowledgement,
    codec::{CodecId, Decoder},
    frame::Frame,
    mask::{Mask, MaskShape},
    message::{ClientMessage, Hello},
    reassembler::{Policy, Reassembler},
    references::KeptMasks,
};

use super::{
    LIGHTS, Rig,
    client::{HEIGHT, Native, WIDTH, hello},
    soon,
};

/// Sends the pose until its frame arrives, and returns the frame's body.
async fn body(client: &Native, reassembler: &mut Reassembler, number: u32) -> Vec<u8> {
    let mut sequence = number * 1000;
    soon(async {
        loop {
            client.send_pose(sequence, number);
            sequence += 1;
            let arrived = tokio::time::timeout(std::time::Duration::from_millis(500), async {
                loop {
                    let datagram = client.connection.read_datagram().await.unwrap();
                    reassembler.push(&datagram).unwrap();
                    if let Some(frame) = reassembler.frame().filter(|frame| frame.frame.0 == number) {
                        return frame.body.to_vec();
                    }
                }
            });
            if let Ok(body) = arrived.await {
                return body;
            }
        }
    })
    .await
}

#[tokio::test(flavor = "multi_thread")]
async fn masks_are_coded_against_what_the_client_has() {
    let rig = Rig::start(|_, _| {}).await;
    let mut client = Native::connect(rig.address(), rig.folder.path()).await;
    client.control.welcome(Hello { codec: CodecId::TilesSmall, ..hello() }).await;
    client.control.send(&ClientMessage::Start).await;
    let say = |said: Acknowledgement| client.connection.send_datagram(said.encode().to_vec().into()).unwrap();
    let reference_of = |body: &[u8]| Frame::parse(body).unwrap().head.reference.map(|name| name.frame.0);
    let (mut reassembler, mut decoder, mut kept) =
        (Reassembler::new(Policy::Slices), Decoder::new(), KeptMasks::default());
    let mut mask = Mask::new(MaskShape::new(WIDTH, HEIGHT, LIGHTS).unwrap());

    let first = body(&client, &mut reassembler, 0).await;
    assert_eq!(reference_of(&first), None);
    decoder.decode(&first, &mut mask).unwrap();
    let shown = mask.clone();
    let have_first = kept.keep(&decoder, gnomon_protocol::ids::FrameNumber(0)).unwrap();
    say(have_first);

    let second = body(&client, &mut reassembler, 1).await;
    assert_eq!(reference_of(&second), Some(0));
    let name = Frame::parse(&second).unwrap().head.reference.unwrap();
    mask.words_mut().fill(0);
    decoder.decode_against(kept.reference(name), &second, &mut mask).unwrap();
    assert!(mask == shown, "the same pose gives the same mask");
    assert!(second.len() < first.len(), "{} bytes, and {} without a reference", second.len(), first.len());

    // No mask has this digest.
    let wrong = have_first.mask.map(|mut name| {
        name.digest ^= 1;
        name
    });
    say(Acknowledgement { sequence: 1, mask: wrong });
    assert_eq!(reference_of(&body(&client, &mut reassembler, 2).await), Some(0));
    // The client has lost it. An older acknowledgement arrives late.
    say(Acknowledgement { sequence: 2, mask: None });
    assert_eq!(reference_of(&body(&client, &mut reassembler, 3).await), None);
    say(have_first);
    assert_eq!(reference_of(&body(&client, &mut reassembler, 4).await), None);
}
