//! Finds a way back to a server, or to the one that it named, while the client draws on.
//!
//! Attempts follow each other with growing pauses, and an older one is not given up when the next begins: on a long path a handshake
//! takes longer than the pause. The first that leads to the same scene wins.

use std::time::Duration;

use gnomon_protocol::{ids::SceneDigest, mask::MaskShape, message::Refusal};
use tokio::{
    runtime::Handle,
    sync::{oneshot, watch},
    task::{JoinHandle, JoinSet},
    time::Instant,
};

use super::{
    backoff::Backoff,
    mask_buffer::MaskReader,
    receive_options::Reception,
    session::{Admitted, Introduction, Session, admit},
    state::LinkState,
    url::ServerUrl,
};
use crate::error::ClientError;

/// Attempts at a time.
const ATTEMPTS: usize = 3;

/// How long one attempt may take.
const PATIENCE: Duration = Duration::from_secs(4);

/// The longest that a server may ask to wait: it does not decide when this client gives up.
const LONGEST_RETRY: Duration = Duration::from_secs(60);

/// All that it takes to start the same session again.
#[derive(Debug, Clone)]
pub(crate) struct Again {
    pub(crate) url: ServerUrl,
    pub(crate) introduction: Introduction,
    pub(crate) scene_digest: SceneDigest,
    pub(crate) shape: MaskShape,
    pub(crate) reception: Reception,
}

/// A search for a server, in the background. Dropping it ends it.
#[derive(Debug)]
pub(crate) struct Redial {
    found: oneshot::Receiver<(Session, MaskReader)>,
    state: watch::Receiver<LinkState>,
    task: JoinHandle<()>,
}

impl Redial {
    /// Looks for the servers of `again` and, before it, `alternative`, because of `reason`.
    pub(crate) fn start(runtime: &Handle, again: Again, alternative: Option<ServerUrl>, reason: String) -> Self {
        let (find, found) = oneshot::channel();
        let first = LinkState::Lost { reason: reason.clone(), retry_at: Some(std::time::Instant::now()) };
        let (told, state) = watch::channel(first);
        let task = runtime.spawn(async move {
            if let Some(session) = search(&again, alternative, reason, &told).await {
                // A client that does not want it any more has dropped the other end, and the session ends with it.
                let _ = find.send(session);
            }
        });
        Self { found, state, task }
    }

    /// How the search stands.
    pub(crate) fn state(&self) -> LinkState {
        self.state.borrow().clone()
    }

    /// The session, once there is one.
    pub(crate) fn take_found(&mut self) -> Option<(Session, MaskReader)> {
        self.found.try_recv().ok()
    }
}

impl Drop for Redial {
    fn drop(&mut self) {
        self.task.abort();
    }
}

/// Connects for the first time. A server that says when to ask again is asked then, for as long as `introduction.connect_timeout`.
pub(crate) async fn admit_patiently(url: &ServerUrl, introduction: &Introduction) -> Result<Admitted, ClientError> {
    let deadline = Instant::now() + introduction.connect_timeout;
    loop {
        let refusal = match admit(url, introduction).await {
            Err(ClientError::Refused(refusal)) => refusal,
            answered => return answered,
        };
        match refusal.retry_after().map(|pause| Instant::now() + pause).filter(|at| *at < deadline) {
            Some(at) => {
                tracing::warn!(%refusal, "asking again");
                tokio::time::sleep_until(at).await;
            }
            None => return Err(ClientError::Refused(refusal)),
        }
    }
}

/// What an attempt that failed means for the next ones.
enum Verdict {
    /// Another attempt may succeed.
    TryOn(String),
    /// The server said when.
    Wait(String, Duration),
    /// No attempt at this server can succeed.
    Never(String),
}

async fn search(
    again: &Again,
    alternative: Option<ServerUrl>,
    mut reason: String,
    state: &watch::Sender<LinkState>,
) -> Option<(Session, MaskReader)> {
    let mut targets: Vec<ServerUrl> = alternative.into_iter().collect();
    if !targets.contains(&again.url) {
        targets.push(again.url.clone());
    }
    let mut backoff = Backoff::new(std::process::id().into());
    let mut attempts = JoinSet::new();
    let (mut next_at, mut turn) = (Instant::now(), 0);
    loop {
        tokio::select! {
            () = tokio::time::sleep_until(next_at), if attempts.len() < ATTEMPTS && !targets.is_empty() => {
                let target = targets[turn % targets.len()].clone();
                turn += 1;
                attempts.spawn(attempt(again.clone(), target));
                next_at = Instant::now() + backoff.next_pause();
                let retry_at = Some(next_at.into_std());
                state.send_replace(LinkState::Lost { reason: reason.clone(), retry_at });
            }
            Some(ended) = attempts.join_next() => {
                let (target, failure) = match ended {
                    Ok(Ok(found)) => return Some(found),
                    Ok(Err(failed)) => *failed,
                    Err(broken) => {
                        reason = broken.to_string();
                        continue;
                    }
                };
                tracing::debug!(server = %target, %failure, "an attempt to reach the server failed");
                match verdict(&failure) {
                    Verdict::TryOn(cause) => reason = cause,
                    Verdict::Wait(cause, pause) => {
                        next_at = next_at.max(Instant::now() + pause.min(LONGEST_RETRY));
                        let retry_at = Some(next_at.into_std());
                        state.send_replace(LinkState::Refused { reason: cause.clone(), retry_at });
                        reason = cause;
                    }
                    Verdict::Never(cause) => {
                        targets.retain(|other| *other != target);
                        if targets.is_empty() && attempts.is_empty() {
                            tracing::warn!(reason = cause, "the server is not asked again");
                            state.send_replace(match failure {
                                ClientError::Refused(_) => LinkState::Refused { reason: cause, retry_at: None },
                                _ => LinkState::Lost { reason: cause, retry_at: None },
                            });
                            return None;
                        }
                        reason = cause;
                    }
                }
            }
            else => return None,
        }
    }
}

/// One attempt, and whom it was for when it failed.
async fn attempt(again: Again, target: ServerUrl) -> Result<(Session, MaskReader), Box<(ServerUrl, ClientError)>> {
    let connect = async {
        // The session's name is a secret between this client and the server that gave it.
        let resume = again.introduction.resume.filter(|_| target == again.url);
        let admitted = admit(&target, &Introduction { resume, ..again.introduction }).await?;
        let found = admitted.welcome.scene_digest;
        if found != again.scene_digest {
            let reason = format!("it has another scene now ({found}): start the client again");
            return Err(ClientError::Protocol { url: Box::new(target.clone()), reason });
        }
        admitted.start(again.shape, again.reception.clone()).await
    };
    match tokio::time::timeout(PATIENCE, connect).await {
        Ok(Ok(session)) => Ok(session),
        Ok(Err(error)) => Err(Box::new((target, error))),
        Err(_) => {
            let error = ClientError::Unreachable { url: Box::new(target.clone()), after: PATIENCE };
            Err(Box::new((target, error)))
        }
    }
}

fn verdict(failure: &ClientError) -> Verdict {
    let cause = failure.to_string();
    match failure {
        ClientError::Refused(refusal) => match (refusal.retry_after(), refusal) {
            (Some(pause), _) => Verdict::Wait(cause, pause),
            // Somebody will start it again.
            (None, Refusal::Draining) => Verdict::TryOn(cause),
            (None, _) => Verdict::Never(cause),
        },
        ClientError::Certificate(_) | ClientError::Protocol { .. } => Verdict::Never(cause),
        _ => Verdict::TryOn(cause),
    }
}
