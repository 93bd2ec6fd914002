//! Reconnects to a lost server, or to the alternative that it named, while the client keeps drawing.
//!
//! Attempts start after growing pauses. Older attempts continue meanwhile, because on a long path a handshake takes
//! longer than the pause. The first attempt that is admitted wins. If its server has another scene, that is fetched.

use std::time::Duration;

use gnomon_protocol::message::Refusal;
use gnomon_scene::Scene;
use tokio::{
    runtime::Handle,
    sync::{oneshot, watch},
    task::{JoinHandle, JoinSet, spawn_blocking},
    time::{Instant, sleep_until, timeout},
};

use super::{
    backoff::Backoff,
    mask_buffer::MaskReader,
    pending_session::PendingSession,
    scene_cache::SceneCache,
    session::Session,
    session_spec::{SessionOptions, SessionSpec},
    state::LinkState,
    url::ServerUrl,
};
use crate::error::ClientError;

/// Concurrent attempts.
const MAX_ATTEMPTS: usize = 3;

const ATTEMPT_TIMEOUT: Duration = Duration::from_secs(4);

/// Longest pause that a server can ask for.
const MAX_RETRY_PAUSE: Duration = Duration::from_secs(60);

/// What a search has found.
pub(crate) enum Found {
    /// The same scene; masks can arrive.
    SameScene(Box<(Session, MaskReader)>),
    OtherScene(Box<OtherScene>),
}

/// A server's new scene, and a session that can start.
pub(crate) struct OtherScene {
    pub(crate) pending: PendingSession,
    pub(crate) scene: Scene,
}

/// A background search for a server. Dropping it ends it.
pub(crate) struct Reconnect {
    found: oneshot::Receiver<Found>,
    state: watch::Receiver<LinkState>,
    task: JoinHandle<()>,
}

impl Reconnect {
    /// Starts to look for `alternative`, if any, and for the server of `spec`. `reason` is why the server was lost.
    pub(crate) fn start(
        runtime: &Handle,
        spec: SessionSpec,
        cache: SceneCache,
        alternative: Option<ServerUrl>,
        reason: String,
    ) -> Self {
        let (send, found) = oneshot::channel();
        let first = LinkState::Lost { reason: reason.clone(), retry_at: Some(std::time::Instant::now()) };
        let (state_sender, state) = watch::channel(first);
        let task = runtime.spawn(async move {
            let stop = spec.options.stop.clone();
            let searched = stop.unless(search(&spec, &cache, alternative, reason, &state_sender)).await;
            if let Ok(Some(found)) = searched {
                // If the receiver is gone, the session is dropped with it.
                let _ = send.send(found);
            }
        });
        Self { found, state, task }
    }

    pub(crate) fn state(&self) -> LinkState {
        self.state.borrow().clone()
    }

    /// Returns the server once it is found.
    pub(crate) fn poll(&mut self) -> Option<Found> {
        self.found.try_recv().ok()
    }
}

impl Drop for Reconnect {
    fn drop(&mut self) {
        self.task.abort();
    }
}

/// Opens a session. Retries when the server asks for it, for up to `options.connect_timeout`.
///
/// # Errors
/// As [`PendingSession::open`].
pub(crate) async fn open_with_retry(url: &ServerUrl, options: &SessionOptions) -> Result<PendingSession, ClientError> {
    let deadline = Instant::now() + options.connect_timeout;
    loop {
        let refusal = match PendingSession::open(url, options).await {
            Err(ClientError::Refused(refusal)) => refusal,
            opened => return opened,
        };
        match refusal.retry_after().map(|pause| Instant::now() + pause).filter(|at| *at < deadline) {
            Some(at) => {
                tracing::warn!(%refusal, "asking again");
                options.stop.unless(sleep_until(at)).await?;
            }
            None => return Err(ClientError::Refused(refusal)),
        }
    }
}

/// What to do after a failed attempt.
enum Retry {
    Soon,
    After(Duration),
    Never,
}

async fn search(
    spec: &SessionSpec,
    cache: &SceneCache,
    alternative: Option<ServerUrl>,
    mut reason: String,
    state: &watch::Sender<LinkState>,
) -> Option<Found> {
    let mut servers: Vec<ServerUrl> = alternative.into_iter().collect();
    if !servers.contains(&spec.url) {
        servers.push(spec.url.clone());
    }
    let mut backoff = Backoff::new(std::process::id().into());
    let mut attempts = JoinSet::new();
    let (mut next_at, mut turn) = (Instant::now(), 0);
    loop {
        tokio::select! {
            () = sleep_until(next_at), if attempts.len() < MAX_ATTEMPTS && !servers.is_empty() => {
                let server = servers[turn % servers.len()].clone();
                turn += 1;
                attempts.spawn(attempt(spec.clone(), server));
                next_at = Instant::now() + backoff.next_pause();
                let retry_at = Some(next_at.into_std());
                state.send_replace(LinkState::Lost { reason: reason.clone(), retry_at });
            }
            Some(ended) = attempts.join_next() => {
                let found = match ended {
                    Ok(Ok(Admitted::Started(session))) => return Some(Found::SameScene(session)),
                    Ok(Ok(Admitted::OtherScene(pending))) => {
                        // Two of them would fetch the same scene.
                        attempts.abort_all();
                        let server = pending.url().clone();
                        fetch(*pending, cache, state).await.map_err(|error| Box::new((server, error)))
                    }
                    Ok(Err(failed)) => Err(failed),
                    Err(panicked) => {
                        if panicked.is_panic() {
                            reason = panicked.to_string();
                        }
                        continue;
                    }
                };
                let (server, error) = match found {
                    Ok(other) => return Some(Found::OtherScene(Box::new(other))),
                    Err(failed) => *failed,
                };
                reason = explained(&error, spec);
                tracing::debug!(%server, failure = reason, "an attempt to reach the server failed");
                match retry(&error) {
                    Retry::Soon => {}
                    Retry::After(pause) => {
                        next_at = next_at.max(Instant::now() + pause.min(MAX_RETRY_PAUSE));
                        let retry_at = Some(next_at.into_std());
                        state.send_replace(LinkState::Refused { reason: reason.clone(), retry_at });
                    }
                    Retry::Never => {
                        servers.retain(|other| *other != server);
                        if servers.is_empty() && attempts.is_empty() {
                            tracing::warn!(reason, "the search for a server has ended");
                            state.send_replace(match error {
                                ClientError::Refused(_) => LinkState::Refused { reason, retry_at: None },
                                _ => LinkState::Lost { reason, retry_at: None },
                            });
                            return None;
                        }
                    }
                }
            }
            else => return None,
        }
    }
}

/// An attempt that the server admitted.
enum Admitted {
    Started(Box<(Session, MaskReader)>),
    OtherScene(Box<PendingSession>),
}

async fn attempt(spec: SessionSpec, server: ServerUrl) -> Result<Admitted, Box<(ServerUrl, ClientError)>> {
    let open = async {
        // The resume token is a secret between this client and the server that issued it.
        let resume = spec.options.resume.filter(|_| server == spec.url);
        let pending = PendingSession::open(&server, &SessionOptions { resume, ..spec.options }).await?;
        if pending.welcome.scene_digest != spec.scene_digest {
            return Ok(Admitted::OtherScene(Box::new(pending)));
        }
        Ok(Admitted::Started(Box::new(pending.start(spec.shape, spec.reception).await?)))
    };
    let opened = timeout(ATTEMPT_TIMEOUT, open)
        .await
        .unwrap_or_else(|_| Err(ClientError::Unreachable { url: Box::new(server.clone()), after: ATTEMPT_TIMEOUT }));
    opened.map_err(|error| Box::new((server, error)))
}

/// Fetches the scene of an admitted session.
async fn fetch(
    mut pending: PendingSession,
    cache: &SceneCache,
    state: &watch::Sender<LinkState>,
) -> Result<OtherScene, ClientError> {
    tracing::warn!(scene = %pending.welcome.scene_digest, "the server has another scene: fetching it");
    let show = |have, length| state.send_replace(LinkState::Fetching { have, length });
    show(0, 0);
    let packed = pending.fetch_scene(cache, |have, length| drop(show(have, length))).await?;
    let unpacked = spawn_blocking(move || pending.unpack(&packed).map(|scene| OtherScene { pending, scene })).await;
    unpacked.map_err(|panicked| ClientError::System(std::io::Error::other(panicked)))?
}

/// Returns the error for a person whose client was served before.
fn explained(error: &ClientError, spec: &SessionSpec) -> String {
    match error {
        ClientError::Refused(Refusal::Token) if spec.options.token.is_some() => {
            "the server no longer takes this token, which is used up, expired or withdrawn: get a new one".to_owned()
        }
        error => error.to_string(),
    }
}

fn retry(error: &ClientError) -> Retry {
    match error {
        // A draining server may be restarted.
        ClientError::Refused(Refusal::Draining) => Retry::Soon,
        ClientError::Refused(refusal) => refusal.retry_after().map_or(Retry::Never, Retry::After),
        // A scene that cannot be unpacked and a file that cannot be written stay so.
        ClientError::Certificate(_)
        | ClientError::OtherVersion(_)
        | ClientError::Protocol { .. }
        | ClientError::Fetch(_)
        | ClientError::Unpack(_)
        | ClientError::Write { .. }
        | ClientError::Stopped(_) => Retry::Never,
        _ => Retry::Soon,
    }
}
