//! The data behind the admin address and the OTLP reports.

use std::{
    net::SocketAddr,
    sync::{Arc, OnceLock},
};

use super::{
    logs::sink,
    readiness::{Readiness, Stage},
};
use crate::{
    admission::tokens::store::TokenStore,
    metrics::{page::Page, process, registry::Metrics},
};

pub(crate) struct Status {
    pub(crate) metrics: Arc<Metrics>,
    pub(crate) readiness: Readiness,
    /// The tracing back end, once it has started.
    pub(crate) backend: OnceLock<String>,
    /// Most sessions at once.
    pub(crate) capacity: usize,
    /// Local address of the UDP socket.
    pub(crate) socket: Option<SocketAddr>,
    pub(crate) tokens: Option<Arc<TokenStore>>,
}

impl Status {
    /// Returns the current values of all metrics.
    pub(crate) fn page(&self) -> Page {
        let stage = self.readiness.get();
        Page {
            ready: stage == Stage::Ready,
            draining: stage == Stage::Draining,
            version: env!("CARGO_PKG_VERSION"),
            backend: self.backend.get().cloned().unwrap_or_default(),
            capacity: self.capacity,
            retries: self.metrics.socket.retries(),
            log_lines_lost: sink::lines_lost(),
            process: process::read(self.socket),
            counts: self.metrics.snapshot(),
        }
    }
}
