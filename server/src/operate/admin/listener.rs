//! What an operator's tools ask over HTTP: is it alive, is it ready, what does it count, whom does it serve.
//!
//! `GET /live`, `/ready`, `/metrics` (Prometheus text), `/sessions` (JSON). It listens on loopback unless told otherwise, apart from the
//! clients' port, and from the start: a server that still loads its scene is alive and not ready.

use std::{io, net::SocketAddr, sync::Arc};

use hyper::{server::conn::http1, service::service_fn};
use hyper_util::rt::{TokioIo, TokioTimer};
use thiserror::Error;
use tokio::{
    net::{TcpListener, TcpStream},
    sync::{OwnedSemaphorePermit, Semaphore},
    task::JoinHandle,
    time::timeout,
};

use super::answer::{self, Sources};
use crate::{
    config::{AdminAddress, ServerConfig},
    limits::{ADMIN_TIMEOUT, MAX_ADMIN_CONNECTIONS},
    operate::otlp::report,
};

/// Why the admin address cannot be listened on.
#[derive(Debug, Error)]
#[error("cannot listen on the admin address {address}: {reason}; pass another --admin ADDR:PORT, or --admin off")]
pub struct AdminError {
    address: SocketAddr,
    reason: io::Error,
}

/// The admin address that listens, and the collector that is reported to, if they are wanted. Both end with their owner.
#[derive(Debug)]
pub(crate) struct Admin {
    local_addr: Option<SocketAddr>,
    tasks: Vec<JoinHandle<()>>,
}

impl Drop for Admin {
    fn drop(&mut self) {
        for task in &self.tasks {
            task.abort();
        }
    }
}

impl Admin {
    /// Listens, and reports.
    ///
    /// # Errors
    /// When the address is taken or cannot be used.
    pub(crate) async fn start(config: &ServerConfig, sources: &Arc<Sources>) -> Result<Self, AdminError> {
        let mut admin = Self { local_addr: None, tasks: Vec::new() };
        if let Some(AdminAddress(address)) = config.admin {
            let failed = |reason| AdminError { address, reason };
            let listener = TcpListener::bind(address).await.map_err(failed)?;
            let local_addr = listener.local_addr().map_err(failed)?;
            tracing::info!(%local_addr, "admin address");
            admin.local_addr = Some(local_addr);
            admin.tasks.push(tokio::spawn(accept(listener, Arc::clone(sources))));
        }
        if let Some(collector) = &config.otlp {
            admin.tasks.push(tokio::spawn(report::run(collector.clone(), Arc::clone(sources))));
        }
        Ok(admin)
    }

    /// Where it listens, if it does.
    pub(crate) const fn local_addr(&self) -> Option<SocketAddr> {
        self.local_addr
    }
}

async fn accept(listener: TcpListener, sources: Arc<Sources>) {
    let seats = Arc::new(Semaphore::new(MAX_ADMIN_CONNECTIONS));
    loop {
        // Whoever comes while all are taken waits in the kernel's queue, which has a bound.
        let Ok(seat) = Arc::clone(&seats).acquire_owned().await else { return };
        match listener.accept().await {
            Ok((stream, _)) => drop(tokio::spawn(serve(stream, seat, Arc::clone(&sources)))),
            Err(error) => {
                tracing::warn!(%error, "cannot accept an admin connection");
                tokio::time::sleep(std::time::Duration::from_millis(100)).await;
            }
        }
    }
}

/// One connection, for a few seconds: whoever scrapes comes again.
async fn serve(stream: TcpStream, _seat: OwnedSemaphorePermit, sources: Arc<Sources>) {
    let service = service_fn(move |request| {
        let sources = Arc::clone(&sources);
        async move { Ok::<_, std::convert::Infallible>(answer::answer(&request, &sources)) }
    });
    let connection = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(ADMIN_TIMEOUT)
        .max_buf_size(16 * 1024)
        .keep_alive(false)
        .serve_connection(TokioIo::new(stream), service);
    // A peer that breaks off, or never reads, has no one to be told.
    let _ = timeout(ADMIN_TIMEOUT, connection).await;
}
