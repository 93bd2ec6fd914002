//! How sessions and servers end.

use std::time::Duration;

use gnomon_protocol::message::{ClientMessage, Refusal, ServerMessage};

use super::{
    Rig,
    client::{Frames, Native, hello},
    soon,
};

#[tokio::test(flavor = "multi_thread")]
async fn a_draining_server_notifies_serves_and_then_closes() {
    let rig = Rig::start(|config, _| {
        config.drain_ms = 3_000;
        config.alternative = Some("gnomon://elsewhere:1/".to_owned());
    })
    .await;
    let mut client = Native::started(rig.address(), rig.folder.path()).await;
    let mut frames = Frames::new();
    client.frame(&mut frames, 0).await;
    let mut late = Native::connect(rig.address(), rig.folder.path()).await;
    let Rig { server, folder } = rig;
    let stopping = tokio::spawn(server.shutdown());
    match client.control.receive().await {
        Some(ServerMessage::Draining { deadline_ms, alternative, .. }) => {
            assert_eq!((deadline_ms, alternative), (3_000, Some("gnomon://elsewhere:1/".into())));
        }
        other => panic!("{other:?}"),
    }
    late.control.send(&ClientMessage::Hello(hello())).await;
    assert_eq!(late.control.receive().await, Some(ServerMessage::Refused(Refusal::Draining)));
    client.frame(&mut frames, 1).await;
    assert!(matches!(client.control.receive().await, Some(ServerMessage::Closing { may_return: true, .. })));
    assert_eq!(client.control.receive().await, None);
    client.connection.close(0u32.into(), b"");
    soon(stopping).await.unwrap();
    drop(folder);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_drained_server_does_not_wait_for_its_deadline() {
    let rig = Rig::start(|config, _| config.drain_ms = 3_600_000).await;
    let mut client = Native::started(rig.address(), rig.folder.path()).await;
    client.frame(&mut Frames::new(), 0).await;
    let Rig { server, folder } = rig;
    let stopping = tokio::spawn(server.shutdown());
    assert!(matches!(client.control.receive().await, Some(ServerMessage::Draining { .. })));
    client.control.send(&ClientMessage::Bye).await;
    soon(stopping).await.unwrap();
    drop(folder);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_vanished_client_ends_within_the_idle_timeout() {
    let rig = Rig::start(|config, _| config.idle_timeout_ms = 500).await;
    let stays = Native::started(rig.address(), rig.folder.path()).await;
    let mut frames = Frames::new();
    stays.frame(&mut frames, 0).await;
    let (address, folder) = (rig.address(), rig.folder.path().to_owned());
    let (its_runtime, vanished) = tokio::task::spawn_blocking(move || {
        let runtime = tokio::runtime::Runtime::new().unwrap();
        let client = runtime.block_on(async {
            let client = Native::started(address, &folder).await;
            client.frame(&mut Frames::new(), 0).await;
            client
        });
        (runtime, client)
    })
    .await
    .unwrap();
    rig.sessions(2).await;
    // Packets stop without a close, as after SIGKILL: keeping the client object prevents a close.
    its_runtime.shutdown_background();
    rig.sessions(1).await;
    // The other client is silent but alive: keep-alives keep its session for several timeouts.
    tokio::time::sleep(Duration::from_millis(1_500)).await;
    stays.frame(&mut frames, 1).await;
    drop(vanished);
}
