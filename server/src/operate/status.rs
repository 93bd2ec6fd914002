//! The data behind the admin address and the OTLP reports.

use std::{
    net::SocketAddr,
    sync::{
        Arc, OnceLock, Weak,
        atomic::{AtomicBool, Ordering},
    },
};

use gnomon_protocol::ids::SessionId;

use super::{
    admin::hosts::AdminHosts,
    logs::{sink, site_limit},
    readiness::{Readiness, Stage},
};
use crate::{
    admission::{
        end_reason::EndReason,
        services::Services,
        tokens::{scope::Scope, store::TokenStore},
    },
    metrics::{page::Page, process, registry::Metrics, reloads::Reloads},
};

pub(crate) struct Status {
    pub(crate) metrics: Arc<Metrics>,
    pub(crate) readiness: Readiness,
    /// The tracing back end, once it has started.
    pub(crate) backend: OnceLock<String>,
    /// What sessions share, once the server listens.
    pub(crate) services: OnceLock<Weak<Services>>,
    /// Most sessions at once.
    pub(crate) capacity: usize,
    /// Local address of the UDP socket.
    pub(crate) socket: Option<SocketAddr>,
    pub(crate) tokens: Option<Arc<TokenStore>>,
    /// A token with the scope admin was listed at some time since the start.
    pub(crate) had_admin_token: AtomicBool,
    /// Everybody who reaches the server is admitted, and not only this machine reaches it.
    pub(crate) open: bool,
    /// Names of the admin address.
    pub(crate) hosts: AdminHosts,
    pub(crate) reloads: Reloads,
}

impl Status {
    /// Call it once all files have been read for the first time.
    pub(crate) fn loaded(&self, has_certificate: bool) {
        self.tokens_loaded();
        if self.tokens.is_some() {
            self.reloads.tokens.succeeded();
        }
        if has_certificate {
            self.reloads.certificate.succeeded();
        }
    }

    /// Call it after the tokens have been loaded. The admin address closes with the first token for it, and stays
    /// closed when a reload withdraws the last one: a slip in the file must not open it.
    pub(crate) fn tokens_loaded(&self) {
        if self.tokens.as_ref().is_some_and(|tokens| tokens.has(Scope::Admin)) {
            self.had_admin_token.store(true, Ordering::Release);
        }
    }

    /// Returns whether `/metrics` and `/sessions` need a token. `/live` and `/ready` never do.
    pub(crate) fn requires_token(&self) -> bool {
        self.tokens_loaded();
        self.had_admin_token.load(Ordering::Acquire)
    }

    /// Ends a session. Returns whether there was one with this id.
    pub(crate) fn end_session(&self, id: u64) -> bool {
        let services = self.services.get().and_then(Weak::upgrade);
        services.is_some_and(|services| services.permits.end(SessionId(id), EndReason::Operator))
    }

    /// Returns the current values of all metrics.
    pub(crate) fn page(&self) -> Page {
        let stage = self.readiness.get();
        Page {
            ready: stage == Stage::Ready,
            draining: stage == Stage::Draining,
            open: self.open,
            version: env!("CARGO_PKG_VERSION"),
            backend: self.backend.get().cloned().unwrap_or_default(),
            capacity: self.capacity,
            retries: self.metrics.socket.retries(),
            log_lines_lost: sink::lines_lost(),
            log_lines_suppressed: site_limit::lines_suppressed(),
            reloads: self.reloads.all().into_iter().chain(sink::opened().get("log")).collect(),
            process: process::read(self.socket),
            counts: self.metrics.snapshot(),
        }
    }
}
