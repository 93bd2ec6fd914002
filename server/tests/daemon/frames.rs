//! A native client's session: Hello, scene, Start, poses, frames.

use gnomon_protocol::{
    codec::Simplifier,
    limits::MAX_WRONG_PPM,
    message::{ClientMessage, Hello, ServerMessage},
};
use gnomon_scene::Scene;

use super::{
    LIGHTS, Rig,
    client::{Frames, HEIGHT, Native, WIDTH, hello, pose_packet},
    soon,
};

#[tokio::test(flavor = "multi_thread")]
async fn a_client_gets_the_scene_and_the_requested_frames() {
    let rig = Rig::start(|_, _| {}).await;
    let mut client = Native::connect(rig.address(), rig.folder.path()).await;
    let welcome = client.control.welcome(hello()).await;
    assert_eq!(welcome.lights, LIGHTS);
    assert_eq!(welcome.data_port, None);
    let packed = client.control.fetch(&welcome, 0).await;
    assert_eq!(blake3::hash(&packed).as_bytes(), &welcome.scene_digest.0);
    assert_eq!(Scene::unpack(&packed).unwrap().lights.len(), LIGHTS as usize);
    let rest = client.control.fetch(&welcome, welcome.scene_bytes - 3).await;
    assert_eq!(rest, packed[packed.len() - 3..], "a broken download can be resumed");
    client.control.send(&ClientMessage::Start).await;

    let mut frames = Frames::new();
    let mask = client.frame(&mut frames, 0).await;
    assert_eq!(frames.timestamp_ms, 0, "time counts from the first frame");
    // Looking down past a low lamp: the blocker's top is lit, and its larger shadow surrounds it.
    let (x, y) = (WIDTH / 2, HEIGHT / 2);
    assert!(mask.get(0, x, y), "the blocker's top sees the lamp above it");
    let lit = |light| {
        (0..HEIGHT).flat_map(|y| (0..WIDTH).map(move |x| (x, y))).filter(|&(x, y)| mask.get(light, x, y)).count()
    };
    let pixels = (WIDTH * HEIGHT) as usize;
    for light in 0..LIGHTS {
        assert!(lit(light) > pixels / 4 && lit(light) < pixels, "light {light} reaches {} of {pixels}", lit(light));
    }
    for number in [1, 2, 30] {
        assert_eq!(client.frame(&mut frames, number).await, mask, "the same pose gives the same frame");
    }
    client.control.send(&ClientMessage::Ping(42)).await;
    assert_eq!(client.control.receive().await, Some(ServerMessage::Pong(42)));
    assert_eq!(rig.server.sessions(), 1);
    client.control.send(&ClientMessage::Bye).await;
    rig.sessions(0).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn garbage_old_poses_and_duplicates_are_dropped() {
    let rig = Rig::start(|_, _| {}).await;
    let client = Native::started(rig.address(), rig.folder.path()).await;
    let mut frames = Frames::new();
    client.frame(&mut frames, 5).await;
    let pose = pose_packet(9_000, 6);
    for length in 0..pose.len() {
        client.connection.send_datagram(pose[..length].to_vec().into()).unwrap();
    }
    let mut bad = pose.clone();
    for byte in 16..pose.len() {
        bad[byte] = 0xff;
        client.connection.send_datagram(bad.clone().into()).unwrap();
    }
    client.connection.send_datagram(vec![0xff; 1100].into()).unwrap();
    // An older pose than frame 5's, and a duplicate of an answered one.
    client.send_pose(9_001, 4);
    client.send_pose(5_000, 5);
    let mask = client.frame(&mut frames, 7).await;
    assert!(mask.words().iter().any(|word| *word != 0));
    let ignored = soon(async {
        client.send_pose(20_000, 7);
        loop {
            let datagram = client.connection.read_datagram().await.unwrap();
            let header = gnomon_protocol::header::PacketHeader::decode(&datagram).unwrap().0;
            if header.frame.unwrap().0 >= 7 {
                break header.frame.unwrap().0;
            }
            assert_eq!(header.frame.unwrap().0, 5, "no frame was traced for a bad or an old pose");
        }
    });
    assert_eq!(ignored.await, 7, "a lost frame can be requested again");
    assert_eq!(rig.server.sessions(), 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn masks_are_lossy_only_as_far_as_the_client_allows() {
    let rig = Rig::start(|_, _| {}).await;
    let mut exact = Native::started(rig.address(), rig.folder.path()).await;
    let mut lossy = Native::connect(rig.address(), rig.folder.path()).await;
    lossy.control.welcome(Hello { wrong_ppm: MAX_WRONG_PPM, ..hello() }).await;
    lossy.control.send(&ClientMessage::Start).await;
    // Downwards and tilted, so that some shadow corner is a single pixel.
    let (sin, cos) = 0.3_f64.sin_cos();
    exact.pose.orientation = [-cos, sin, sin, cos].map(|part| part * std::f64::consts::FRAC_1_SQRT_2);
    lossy.pose = exact.pose;
    let mut expected = exact.frame(&mut Frames::new(), 0).await;
    let received = lossy.frame(&mut Frames::new(), 0).await;
    assert_ne!(received, expected);
    assert!(Simplifier::default().simplify(&mut expected, MAX_WRONG_PPM) > 0);
    assert_eq!(received, expected);
}

#[tokio::test(flavor = "multi_thread")]
async fn two_clients_get_their_own_frames() {
    let rig = Rig::start(|_, _| {}).await;
    let first = Native::started(rig.address(), rig.folder.path()).await;
    let mut second = Native::started(rig.address(), rig.folder.path()).await;
    second.pose.position_m = [1.0, 2.0, 1.5];
    let (mut first_frames, mut second_frames) = (Frames::new(), Frames::new());
    let first_mask = first.frame(&mut first_frames, 0).await;
    let second_mask = second.frame(&mut second_frames, 0).await;
    assert_ne!(first_mask, second_mask);
    for number in 1..6 {
        let (a, b) = tokio::join!(first.frame(&mut first_frames, number), second.frame(&mut second_frames, number));
        assert!(a == first_mask && b == second_mask, "frame {number} belongs to the other client");
    }
    first.endpoint.close(0u32.into(), b"");
    rig.sessions(1).await;
    second.frame(&mut second_frames, 200).await;
}
