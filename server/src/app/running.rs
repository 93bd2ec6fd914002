//! A running server: its queries, reloading, and an orderly shutdown.

use std::{net::SocketAddr, sync::Arc, time::Duration};

use gnomon_protocol::ids::SessionId;
use tokio::{sync::watch, time::timeout};

use super::url;
use crate::{
    admission::{end_reason::EndReason, services::Services},
    limits,
    net::{certificate::Certificates, endpoint::Endpoint},
    operate::{
        admin::Admin,
        readiness::{Readiness, Stage},
        status::Status,
    },
    phase::Phase,
    task::Task,
    visibility::engine::Engine,
    web::Web,
};

/// A listening server. Dropping it ends it at once; [`Self::shutdown`] lets sessions finish.
pub struct RunningServer {
    pub(super) local_addr: SocketAddr,
    pub(super) url_base: String,
    pub(super) certificates: Option<Arc<Certificates>>,
    pub(super) renewing: Option<Task>,
    pub(super) web: Option<Web>,
    pub(super) services: Arc<Services>,
    pub(super) phase: watch::Sender<Phase>,
    pub(super) endpoint: Arc<Endpoint>,
    pub(super) accepting: Task,
    pub(super) readiness: Readiness,
    pub(super) status: Arc<Status>,
    pub(super) admin: Option<Admin>,
    pub(super) otlp: Option<Task>,
    #[cfg(feature = "agones")]
    pub(super) agones: Option<Task>,
}

impl RunningServer {
    /// The bound address, never with port 0.
    #[must_use]
    pub const fn local_addr(&self) -> SocketAddr {
        self.local_addr
    }

    /// The URL for clients: `gnomon://HOST:PORT/?cert=SHA256`, with a second `cert` if the next certificate is
    /// announced, or `gnomon+lab-udp://HOST:PORT/` on lab transports.
    #[must_use]
    pub fn url(&self) -> String {
        match &self.certificates {
            Some(certificates) => url::pinning(&self.url_base, certificates),
            None => self.url_base.clone(),
        }
    }

    /// SHA-256 of the certificate that browsers pin, in hexadecimal; `None` on lab transports, and with an operator's
    /// certificate. Renewed every few days, since browsers reject pinned certificates that are valid for more than 14
    /// days.
    #[must_use]
    pub fn browser_certificate_sha256(&self) -> Option<String> {
        Some(self.certificates.as_ref()?.browser_hashes()?.current)
    }

    /// The tracing back end and its adapter.
    #[must_use]
    pub fn backend(&self) -> String {
        self.services.engine.description().to_owned()
    }

    #[must_use]
    pub fn sessions(&self) -> usize {
        self.services.permits.in_use()
    }

    /// Ends the session with this id, as named in the logs and in `/sessions`, and tells its client that the operator
    /// ended it. Returns whether there was one.
    pub fn end_session(&self, id: u64) -> bool {
        self.services.permits.end(SessionId(id), EndReason::Operator)
    }

    #[must_use]
    pub fn lights(&self) -> u32 {
        self.services.scene.lights
    }

    #[must_use]
    pub fn engines(&self) -> &[Engine] {
        self.services.engine.engines()
    }

    #[must_use]
    pub fn admin_addr(&self) -> Option<SocketAddr> {
        self.admin.as_ref().map(Admin::local_addr)
    }

    #[must_use]
    pub fn web_addr(&self) -> Option<SocketAddr> {
        self.web.as_ref().map(Web::local_addr)
    }

    /// Reloads the token file and the certificate. Sessions end whose token was withdrawn. An unusable file is logged
    /// and changes nothing.
    pub fn reload(&self) {
        if let Some(tokens) = &self.services.tokens {
            let outcome = &self.status.reloads.tokens;
            match tokens.reload() {
                Ok(listed) => {
                    self.status.tokens_loaded();
                    outcome.succeeded();
                    tracing::info!(listed, "tokens reloaded");
                }
                Err(error) => {
                    outcome.failed();
                    tracing::error!(%error, "cannot reload the tokens; the old ones stay valid");
                }
            }
        }
        if let Some(certificates) = &self.certificates {
            let outcome = &self.status.reloads.certificate;
            match certificates.reload() {
                Ok(()) => {
                    outcome.succeeded();
                    tracing::info!(
                        sha256 = certificates.permanent_sha256(),
                        next_sha256 = certificates.next_sha256(),
                        "certificate reloaded"
                    );
                }
                Err(error) => {
                    outcome.failed();
                    tracing::error!(%error, "cannot reload the certificate; the old one stays in use");
                }
            }
        }
    }

    /// Returns a check of whether the engines' threads answer, for a supervisor's watchdog.
    pub fn pulse(&self) -> impl Fn() -> bool + Send + use<> {
        let services = Arc::clone(&self.services);
        move || services.engine.answers()
    }

    /// Waits until tracing fails for good, for example by a lost device. Returns the reason. The server then still
    /// listens but refuses every client, so shut it down.
    pub async fn failed(&self) -> String {
        let reason = self.services.engine.ended().await;
        self.readiness.set(Stage::Failed(reason.clone()));
        reason
    }

    /// Refuses new clients, asks others to leave, serves them for up to `drain_ms`, finishes their frames, and ends.
    pub async fn shutdown(self) {
        let Self {
            services,
            phase,
            endpoint,
            mut accepting,
            readiness,
            admin,
            otlp,
            renewing,
            web,
            #[cfg(feature = "agones")]
            agones,
            ..
        } = self;
        readiness.set(Stage::Draining);
        services.permits.close();
        tracing::info!(sessions = services.permits.in_use(), drain_ms = services.drain_ms, "draining");
        phase.send_replace(Phase::Draining);
        let empty = async {
            while services.permits.in_use() > 0 {
                tokio::time::sleep(Duration::from_millis(10)).await;
            }
        };
        let _ = timeout(Duration::from_millis(services.drain_ms.into()), empty).await;
        phase.send_replace(Phase::Stopping);
        let limit = limits::FINISH_TIMEOUT + 3 * limits::LINGER + limits::CLOSE_TIMEOUT;
        if timeout(limit, &mut accepting.0).await.is_err() {
            tracing::warn!("sessions did not end in {limit:?}");
            accepting.0.abort();
            let _ = (&mut accepting.0).await;
        }
        endpoint.close().await;
        drop(endpoint);
        // Joining a thread must not block a runtime worker.
        if let Err(error) = tokio::task::spawn_blocking(move || services.engine.shutdown()).await {
            tracing::error!(%error, "the engine panicked");
        }
        #[cfg(feature = "agones")]
        if agones.is_some() {
            crate::operate::agones::shutdown().await;
        }
        drop((admin, otlp, renewing, web));
        tracing::info!("stopped");
    }
}
