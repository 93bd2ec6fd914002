//! Listens on the admin address.

use std::{
    io,
    net::SocketAddr,
    sync::{Arc, atomic::Ordering},
    time::Duration,
};

use hyper::{server::conn::http1, service::service_fn};
use hyper_util::rt::{TokioIo, TokioTimer};
use thiserror::Error;
use tokio::{
    net::{TcpListener, TcpStream},
    time::timeout,
};

use super::{
    answer::answer,
    seats::{Asked, Seats},
};
use crate::{limits::ADMIN_TIMEOUT, operate::status::Status, task::Task};

#[derive(Debug, Error)]
#[error("cannot listen on the admin address {address}: {reason}; pass another --admin ADDR:PORT, or --admin off")]
pub struct AdminError {
    address: SocketAddr,
    reason: io::Error,
}

/// A listening admin address. Dropping it closes it.
#[derive(Debug)]
pub(crate) struct Admin {
    local_addr: SocketAddr,
    _accepting: Task,
}

impl Admin {
    /// Errors if the address is taken or unusable.
    pub(crate) async fn start(address: SocketAddr, status: &Arc<Status>) -> Result<Self, AdminError> {
        let failed = |reason| AdminError { address, reason };
        let listener = TcpListener::bind(address).await.map_err(failed)?;
        let local_addr = listener.local_addr().map_err(failed)?;
        tracing::info!(%local_addr, "admin address");
        Ok(Self { local_addr, _accepting: Task::spawn(accept(listener, Arc::clone(status))) })
    }

    pub(crate) const fn local_addr(&self) -> SocketAddr {
        self.local_addr
    }
}

async fn accept(listener: TcpListener, status: Arc<Status>) {
    let mut seats = Seats::default();
    loop {
        match listener.accept().await {
            Ok((stream, _)) => seats.seat(|asked| serve(stream, asked, Arc::clone(&status))).await,
            Err(error) => {
                tracing::warn!(%error, "cannot accept an admin connection");
                tokio::time::sleep(Duration::from_millis(100)).await;
            }
        }
    }
}

/// Serves one connection, without keep-alive.
async fn serve(stream: TcpStream, asked: Asked, status: Arc<Status>) {
    let service = service_fn(move |request| {
        asked.store(true, Ordering::Relaxed);
        let status = Arc::clone(&status);
        async move { Ok::<_, std::convert::Infallible>(answer(&request, &status)) }
    });
    let connection = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(ADMIN_TIMEOUT)
        .max_buf_size(16 * 1024)
        .keep_alive(false)
        .serve_connection(TokioIo::new(stream), service);
    // A peer that disconnects or never reads is not an error.
    let _ = timeout(ADMIN_TIMEOUT, connection).await;
}
