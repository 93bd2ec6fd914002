//! Listens on the web address.

use std::{io, net::SocketAddr, sync::Arc, time::Duration};

use hyper::{server::conn::http1, service::service_fn};
use hyper_util::rt::{TokioIo, TokioTimer};
use rustls::crypto::CryptoProvider;
use socket2::SockRef;
use thiserror::Error;
use tokio::{
    io::{AsyncRead, AsyncWrite},
    net::{TcpListener, TcpStream},
    sync::Semaphore,
    time::timeout,
};
use tokio_rustls::TlsAcceptor;

use super::{
    answer::{Page, answer},
    files::FilesError,
    socket,
};
use crate::{
    admission::addresses::AddressLimit,
    limits::{
        MAX_WEB_CONNECTIONS, MAX_WEB_CONNECTIONS_PER_ADDRESS, SOCKET_SEND_BUFFER_BYTES, WEB_CONNECTION_TIMEOUT,
        WEB_TIMEOUT,
    },
    net::certificate::Certificates,
    task::Task,
};

#[derive(Debug, Error)]
pub enum WebError {
    #[error("cannot listen on the web address {address}: {reason}; pass another --web ADDR:PORT")]
    Listen { address: SocketAddr, reason: io::Error },
    #[error("cannot set up TLS for the web address: {0}")]
    Tls(#[from] rustls::Error),
    #[error(transparent)]
    Files(#[from] FilesError),
}

/// A web address that answers nobody yet. Binding comes before loading the scene, so that a taken port fails early.
pub(crate) struct Bound(TcpListener, SocketAddr);

/// A listening web address. Dropping it closes it.
#[derive(Debug)]
pub(crate) struct Web {
    local_addr: SocketAddr,
    _accepting: Task,
}

impl Bound {
    /// Errors if the address is taken or unusable.
    pub(crate) async fn listen(address: SocketAddr) -> Result<Self, WebError> {
        let failed = |reason| WebError::Listen { address, reason };
        let listener = TcpListener::bind(address).await.map_err(failed)?;
        let local_addr = listener.local_addr().map_err(failed)?;
        Ok(Self(listener, local_addr))
    }

    /// Starts to answer: over TLS where browsers trust the certificate. Errors if TLS refuses.
    pub(crate) fn serve(self, page: Page, provider: &Arc<CryptoProvider>) -> Result<Web, WebError> {
        let Self(listener, local_addr) = self;
        let tls = match page.certificates.browser_hashes() {
            None => Some(acceptor(Arc::clone(&page.certificates), provider)?),
            Some(_) => None,
        };
        tracing::info!(%local_addr, tls = tls.is_some(), page = page.files.is_some(), "web address");
        Ok(Web { local_addr, _accepting: Task::spawn(accept(listener, tls, Arc::new(page))) })
    }
}

impl Web {
    pub(crate) const fn local_addr(&self) -> SocketAddr {
        self.local_addr
    }
}

fn acceptor(certificates: Arc<Certificates>, provider: &Arc<CryptoProvider>) -> Result<TlsAcceptor, rustls::Error> {
    let mut tls = rustls::ServerConfig::builder_with_provider(Arc::clone(provider))
        .with_protocol_versions(&[&rustls::version::TLS13])?
        .with_no_client_auth()
        .with_cert_resolver(certificates);
    tls.alpn_protocols = vec![b"http/1.1".to_vec()];
    Ok(TlsAcceptor::from(Arc::new(tls)))
}

async fn accept(listener: TcpListener, tls: Option<TlsAcceptor>, page: Arc<Page>) {
    let seats = Arc::new(Semaphore::new(MAX_WEB_CONNECTIONS));
    let addresses = AddressLimit::new(MAX_WEB_CONNECTIONS_PER_ADDRESS, false);
    loop {
        match listener.accept().await {
            Ok((stream, peer)) => {
                // Without a seat it is closed at once: a page asks again, and waiting would queue behind idle peers.
                let seat = Arc::clone(&seats).try_acquire_owned().ok().zip(addresses.acquire(peer.ip()));
                if let Some(seat) = seat {
                    let (tls, page) = (tls.clone(), Arc::clone(&page));
                    tokio::spawn(async move {
                        // A peer that disconnects, never reads or speaks no TLS is not an error.
                        let _ = timeout(WEB_CONNECTION_TIMEOUT, serve(stream, peer, tls, page)).await;
                        drop(seat);
                    });
                }
            }
            Err(error) => {
                tracing::warn!(%error, "cannot accept a web connection");
                tokio::time::sleep(Duration::from_millis(100)).await;
            }
        }
    }
}

async fn serve(stream: TcpStream, peer: SocketAddr, tls: Option<TlsAcceptor>, page: Arc<Page>) {
    // A session's frames are small, and late ones are worth nothing.
    let _ = stream.set_nodelay(true);
    let _ = SockRef::from(&stream).set_send_buffer_size(SOCKET_SEND_BUFFER_BYTES);
    match tls {
        None => exchange(stream, peer, page).await,
        Some(tls) => {
            if let Ok(Ok(stream)) = timeout(WEB_TIMEOUT, tls.accept(stream)).await {
                exchange(stream, peer, page).await;
            }
        }
    }
}

/// Serves one connection: a page asks for its files over a few of them.
async fn exchange(stream: impl AsyncRead + AsyncWrite + Unpin + Send + 'static, peer: SocketAddr, page: Arc<Page>) {
    let service = service_fn(move |request| {
        let page = Arc::clone(&page);
        async move {
            Ok::<_, std::convert::Infallible>(if socket::is_wanted(&request) {
                socket::upgrade(request, peer, page.origins.as_ref(), &page.arrivals)
            } else {
                answer(&request, &page)
            })
        }
    });
    let connection = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(WEB_TIMEOUT)
        .max_buf_size(16 * 1024)
        .serve_connection(TokioIo::new(stream), service)
        .with_upgrades();
    let _ = connection.await;
}
