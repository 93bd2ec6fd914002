//! Hellos, and admission without connections: real tasks that race.

use std::{path::Path, sync::Barrier};

use bytes::Bytes;
use gnomon_protocol::{
    codec::CodecId,
    ids::{BearerToken, ResumeToken, SceneDigest},
};
use tokio::sync::watch;

use super::*;
use crate::{
    admission::{
        addresses::AddressLimit, capacity::HostCapacity, encoders::Encoders, end_reason::EndReason,
        failed_tokens::FailedTokens, permit::SessionPermits, services::SceneAsset, tokens::store::TokenStore,
    },
    config::{Backend, ServerConfig},
    hex,
    limits::MAX_FAILED_TOKENS,
    metrics::registry::Metrics,
    phase::Phase,
    visibility::{
        engine::{EngineOptions, Fleet},
        test_scenes,
    },
};

const PEER: &str = "192.0.2.7:4000";

/// A server's state without its sockets. `tokens` is the text of the token file.
fn services(folder: &Path, tokens: &str, change: impl FnOnce(&mut ServerConfig)) -> Services {
    let mut config = ServerConfig { max_sessions: 4, max_sessions_per_address: 1, ..ServerConfig::default() };
    change(&mut config);
    let scene = Arc::new(test_scenes::room());
    let options = EngineOptions {
        backend: Backend::Cpu,
        adapter: None,
        allow_software: false,
        threads: std::num::NonZeroUsize::new(1),
        max_sessions: config.max_sessions + 16,
        budget_ms: f64::from(config.device_budget_ms),
        devices: None,
    };
    let path = folder.join("tokens.toml");
    std::fs::write(&path, tokens).unwrap();
    let (_, phase_seen) = watch::channel(Phase::Running);
    Services {
        shared_world: None,
        scene: SceneAsset {
            packed: Bytes::new(),
            digest: SceneDigest([0; 32]),
            lights: u32::try_from(scene.lights.len()).unwrap(),
            weights: vec![1; scene.lights.len()],
            moves: false,
            stage: gnomon_scene::Scene::default(),
        },
        engine: Fleet::start(&scene, &options).unwrap(),
        tokens: (!tokens.is_empty()).then(|| Arc::new(TokenStore::read(&path).unwrap())),
        failed_tokens: FailedTokens::default(),
        origins: None,
        addresses: AddressLimit::new(config.max_sessions_per_address, false),
        metrics: Arc::new(Metrics::default()),
        permits: SessionPermits::new(config.max_sessions),
        capacity: HostCapacity::new(&config, 1, 0, 0),
        phase: phase_seen,
        encoders: Encoders::new(1),
        handshake_timeout: config.handshake_timeout(),
        drain_ms: 0,
        alternative: None,
    }
}

fn once_token(token: &str) -> String {
    format!("[[token]]\nsha256 = \"{}\"\nonce = true\n", hex::encode(&sha256(token.as_bytes())))
}

fn hello(token: Option<&str>, resume: Option<ResumeToken>) -> Hello {
    Hello {
        version: PROTOCOL_VERSION,
        token: token.map(BearerToken::from),
        client: "test".into(),
        width: 64,
        height: 36,
        codec: CodecId::PlanesLz4,
        rate_hz: 30,
        wrong_ppm: 0,
        resume,
    }
}

fn admit(hello: Hello, services: &Services) -> Result<AdmittedClient, Refused> {
    let applicant = apply(hello, services)?;
    let mut admitted = decide(applicant, PEER.parse().unwrap(), services)?;
    admitted.take_over();
    Ok(admitted)
}

#[test]
fn the_version_of_any_hello_can_be_read() {
    for version in [0, 1, 127, 128, 16_383, 16_384, u16::MAX] {
        let hello = Hello {
            version,
            token: Some("t".into()),
            client: "test".into(),
            width: 1,
            height: 1,
            codec: CodecId::PlanesLz4,
            rate_hz: 60,
            wrong_ppm: 0,
            resume: None,
        };
        let bytes = message::encode(&ClientMessage::Hello(hello)).unwrap();
        assert_eq!(peek_version(&bytes[4..]), Some(version));
    }
    let start = message::encode(&ClientMessage::Start).unwrap();
    for bytes in [&[][..], &[0], &[0, 0x80], &[0, 0xff, 0xff, 0xff, 0], &start[4..]] {
        assert_eq!(peek_version(bytes), None, "{bytes:?}");
    }
}

#[test]
fn texts_are_cut_between_characters() {
    let text = "é".repeat(MAX_TEXT_BYTES);
    assert_eq!(shortened(&text).len(), MAX_TEXT_BYTES);
    assert_eq!(shortened(&format!("a{text}")).len(), MAX_TEXT_BYTES - 1);
    assert_eq!(shortened("short"), "short");
}

/// Every task has looked at what it may resume before any of them is decided.
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn racing_clients_get_one_session_for_one_token_and_one_place() {
    for (token, loser) in [(Some("gold"), RefusalCause::Token), (None, RefusalCause::Address)] {
        let folder = tempfile::tempdir().unwrap();
        let text = token.map(once_token).unwrap_or_default();
        let services = Arc::new(services(folder.path(), &text, |_| {}));
        for round in 0..100 {
            // In odd rounds they race to resume a session, in even ones to open one.
            let old = (round % 2 == 1).then(|| admit(hello(token, None), &services).unwrap());
            let admitted = race(&services, &hello(token, old.as_ref().map(|old| old.permit.resume)), loser).await;
            assert_eq!((admitted.len(), services.permits.in_use()), (1, 1), "round {round}");
            if let Some(mut old) = old {
                assert_eq!(old.permit.ended().await, EndReason::Superseded);
            }
            assert_eq!(admit(hello(token, None), &services).map(drop).unwrap_err().0, loser);
            drop(admitted);
            if let Some(tokens) = &services.tokens {
                // A token that is listed anew is unspent.
                for listed in ["other", "gold"] {
                    std::fs::write(folder.path().join("tokens.toml"), once_token(listed)).unwrap();
                    tokens.reload().unwrap();
                }
            }
            while services.engine.sessions() > 0 {
                tokio::time::sleep(std::time::Duration::from_millis(1)).await;
            }
        }
    }
}

/// Sends the same Hello three times at once, and returns the clients that were admitted.
async fn race(services: &Arc<Services>, hello: &Hello, loser: RefusalCause) -> Vec<AdmittedClient> {
    const TASKS: usize = 3;
    let barrier = Arc::new(Barrier::new(TASKS));
    let racing: Vec<_> = (0..TASKS)
        .map(|_| {
            let (hello, services, barrier) = (hello.clone(), Arc::clone(services), Arc::clone(&barrier));
            tokio::task::spawn_blocking(move || {
                let applicant = apply(hello, &services);
                barrier.wait();
                let mut decided = decide(applicant?, PEER.parse().unwrap(), &services);
                if let Ok(admitted) = &mut decided {
                    admitted.take_over();
                }
                // Nobody gives back what another may want before all are decided.
                barrier.wait();
                decided
            })
        })
        .collect();
    let mut admitted = Vec::new();
    for task in racing {
        match task.await.unwrap() {
            Ok(client) => admitted.push(client),
            Err((cause, _)) => assert_eq!(cause, loser),
        }
    }
    admitted
}

/// The budget holds one session. A client that resumes it is judged without it, and leaves it alone if refused.
#[tokio::test]
async fn a_resume_near_the_budget_keeps_its_session() {
    let folder = tempfile::tempdir().unwrap();
    let services = services(folder.path(), "", |config| config.device_budget_ms = 1);
    let first = admit(hello(None, None), &services).unwrap();
    let elsewhere: SocketAddr = "192.0.2.8:1".parse().unwrap();
    let stranger = decide(apply(hello(None, None), &services).unwrap(), elsewhere, &services);
    assert_eq!(stranger.map(drop).unwrap_err().0, RefusalCause::Budget);
    let mut second = admit(hello(None, Some(first.permit.resume)), &services).unwrap();
    drop(first);
    // Refused for another reason: the session that it names stays.
    let wrong = Hello { wrong_ppm: MAX_WRONG_PPM + 1, ..hello(None, Some(second.permit.resume)) };
    assert_eq!(admit(wrong, &services).map(drop).unwrap_err().0, RefusalCause::Unsupported);
    // Admitted, but lost before its Welcome was written.
    let lost = decide(apply(hello(None, Some(second.permit.resume)), &services).unwrap(), elsewhere, &services);
    drop(lost.unwrap());
    let ended = timeout(std::time::Duration::from_millis(20), second.permit.ended()).await;
    assert!(ended.is_err(), "{ended:?}");
    admit(hello(None, Some(second.permit.resume)), &services).unwrap();
    assert_eq!(second.permit.ended().await, EndReason::Superseded);
}

#[tokio::test]
async fn a_session_that_an_operator_ended_is_not_resumed() {
    let folder = tempfile::tempdir().unwrap();
    let services = services(folder.path(), "", |_| {});
    let mut ended = admit(hello(None, None), &services).unwrap();
    assert!(services.permits.end(ended.permit.id, EndReason::Operator));
    assert_eq!(ended.permit.ended().await, EndReason::Operator);
    let (cause, refusal) = admit(hello(None, Some(ended.permit.resume)), &services).map(drop).unwrap_err();
    assert_eq!(cause, RefusalCause::Dismissed);
    assert!(refusal.retry_after().is_some(), "{refusal}");
}

#[test]
fn an_address_with_too_many_wrong_tokens_is_refused_unseen() {
    let folder = tempfile::tempdir().unwrap();
    let services = services(folder.path(), &once_token("gold"), |_| {});
    let first = admit(hello(Some("gold"), None), &services).unwrap();
    for _ in 0..MAX_FAILED_TOKENS {
        assert_eq!(admit(hello(Some("tin"), None), &services).map(drop).unwrap_err().1, Refusal::Token);
    }
    // Even the right token has to wait, but not at another address, and not with the secret of an open session.
    for token in ["tin", "gold"] {
        let (cause, refusal) = admit(hello(Some(token), None), &services).map(drop).unwrap_err();
        assert!(cause == RefusalCause::Token && refusal.retry_after().is_some(), "{refusal}");
    }
    let elsewhere: SocketAddr = "192.0.2.8:1".parse().unwrap();
    let other = decide(apply(hello(Some("tin"), None), &services).unwrap(), elsewhere, &services);
    assert_eq!(other.map(drop).unwrap_err().1, Refusal::Token);
    admit(hello(Some("gold"), Some(first.permit.resume)), &services).unwrap();
}
