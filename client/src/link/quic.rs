//! QUIC connections: certificate checks and quinn's configuration.

use std::{
    net::SocketAddr,
    path::Path,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};

use gnomon_protocol::text::Escaped;
use gnomon_settings::files::read_small;
use gnomon_transport::{
    quic::{ALPN, SOCKET_BUFFER_BYTES, transport_config},
    socket::{any_address_for, bind_udp},
};
use quinn::crypto::rustls::QuicClientConfig;
use rustls::{
    CertificateError, DigitallySignedStruct, Error as TlsError, SignatureScheme,
    client::danger::{HandshakeSignatureValid, ServerCertVerified, ServerCertVerifier},
    crypto::{CryptoProvider, verify_tls12_signature, verify_tls13_signature},
    pki_types::{CertificateDer, ServerName, UnixTime, pem::PemObject as _},
};

use super::url::ServerUrl;
use crate::error::ClientError;

/// Silence after which the connection is lost.
const IDLE_TIMEOUT: Duration = Duration::from_secs(10);

/// Interval of keep-alives on an idle connection.
const KEEP_ALIVE: Duration = Duration::from_secs(2);

/// Bytes in flight before the first acknowledgement: some hundred poses.
const INITIAL_WINDOW_BYTES: u64 = 64 * 1024;

/// Datagrams that may wait while the receive task decodes: several frames of words at 1920×1080, 8 MB each.
const DATAGRAM_RECEIVE_BYTES: usize = 32 << 20;

/// Poses that may wait; quinn drops the oldest beyond that.
const DATAGRAM_SEND_BYTES: usize = 1024;

/// Longest file of authorities. Those that browsers trust, all together, have 0.3 MB.
const MAX_AUTHORITIES_BYTES: u64 = 4 << 20;

/// Accepts only a certificate with a pinned digest, or any on a first visit.
///
/// Its names and dates are ignored: the server that printed the URL holds its key.
#[derive(Debug)]
struct Pinned {
    /// `None` accepts any.
    accepted: Option<Vec<[u8; 32]>>,
    provider: Arc<CryptoProvider>,
    /// Set when another certificate was shown.
    refused: Arc<AtomicBool>,
}

impl ServerCertVerifier for Pinned {
    fn verify_server_cert(
        &self,
        end_entity: &CertificateDer<'_>,
        _intermediates: &[CertificateDer<'_>],
        _server_name: &ServerName<'_>,
        _ocsp_response: &[u8],
        _now: UnixTime,
    ) -> Result<ServerCertVerified, TlsError> {
        let is_pinned = |accepted: &Vec<_>| sha256(end_entity).is_some_and(|digest| accepted.contains(&digest));
        if self.accepted.as_ref().is_none_or(is_pinned) {
            Ok(ServerCertVerified::assertion())
        } else {
            self.refused.store(true, Ordering::Relaxed);
            Err(TlsError::InvalidCertificate(CertificateError::ApplicationVerificationFailure))
        }
    }

    fn verify_tls12_signature(
        &self,
        message: &[u8],
        certificate: &CertificateDer<'_>,
        signature: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, TlsError> {
        verify_tls12_signature(message, certificate, signature, &self.provider.signature_verification_algorithms)
    }

    fn verify_tls13_signature(
        &self,
        message: &[u8],
        certificate: &CertificateDer<'_>,
        signature: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, TlsError> {
        verify_tls13_signature(message, certificate, signature, &self.provider.signature_verification_algorithms)
    }

    fn supported_verify_schemes(&self) -> Vec<SignatureScheme> {
        self.provider.signature_verification_algorithms.supported_schemes()
    }
}

#[derive(Debug)]
pub(super) enum QuicError {
    /// The server shows another certificate than the pinned ones.
    Certificate,
    /// The server speaks none of this client's protocols.
    Version,
    /// The server does not answer.
    TimedOut,
    /// A packet was corrupted on the path: our servers send no such answer.
    Corrupted(String),
    Other(String),
}

/// TLS's alert when the two ends have no ALPN in common (RFC 7301).
const NO_APPLICATION_PROTOCOL: u8 = 120;

impl QuicError {
    /// Returns whether every further handshake would fail as well.
    const fn is_final(&self) -> bool {
        matches!(self, Self::Certificate | Self::Version | Self::Other(_))
    }

    pub(super) fn at_server(self, url: &ServerUrl) -> ClientError {
        let url = Box::new(url.clone());
        match self {
            Self::Certificate => ClientError::Certificate(url),
            Self::Version => ClientError::OtherVersion(url),
            Self::TimedOut => ClientError::Unreachable { url, after: IDLE_TIMEOUT },
            Self::Corrupted(reason) | Self::Other(reason) => ClientError::Connect { url, reason },
        }
    }
}

/// Time after which another handshake starts in parallel: each lost packet doubles a handshake's wait.
const NEXT_HANDSHAKE: Duration = Duration::from_millis(1500);

/// Most handshakes with one address.
const MAX_HANDSHAKES: usize = 6;

#[derive(Debug, Clone, Copy)]
pub(super) enum Trust<'a> {
    /// A certificate with one of these SHA-256, whatever its names and dates.
    Pinned(&'a [[u8; 32]]),
    /// Any certificate, to fetch it on a first visit.
    FirstUse,
    /// A certificate for `name`, signed by an authority in the PEM `file`.
    Authority { file: &'a Path, name: &'a str },
}

/// Connects to the server at `address`. On a network that loses or corrupts many packets one handshake may fail, so
/// several run in parallel and the first success wins.
///
/// # Errors
/// Errors if the server shows a certificate that `trust` does not accept, or all handshakes fail.
pub(super) async fn connect(
    address: SocketAddr,
    trust: Trust<'_>,
) -> Result<(quinn::Endpoint, quinn::Connection), QuicError> {
    let refused = Arc::new(AtomicBool::new(false));
    let config = config(trust, Arc::clone(&refused)).map_err(|error| QuicError::Other(error.to_string()))?;
    // A pinned certificate is accepted whatever the name.
    let name = if let Trust::Authority { name, .. } = trust { name } else { "gnomon" };
    let mut attempts = tokio::task::JoinSet::new();
    let (mut begun, mut next_at) = (0, tokio::time::Instant::now());
    loop {
        let ended = tokio::select! {
            () = tokio::time::sleep_until(next_at), if begun < MAX_HANDSHAKES => {
                attempts.spawn(handshake(address, name.to_owned(), config.clone(), Arc::clone(&refused)));
                begun += 1;
                next_at += NEXT_HANDSHAKE;
                continue;
            }
            Some(ended) = attempts.join_next() => ended,
        };
        match ended {
            Ok(Ok(connected)) => return Ok(connected),
            Ok(Err(error)) if begun == MAX_HANDSHAKES && attempts.is_empty() || error.is_final() => return Err(error),
            Ok(Err(_)) => {}
            Err(broken) => return Err(QuicError::Other(broken.to_string())),
        }
    }
}

async fn handshake(
    address: SocketAddr,
    name: String,
    config: quinn::ClientConfig,
    refused: Arc<AtomicBool>,
) -> Result<(quinn::Endpoint, quinn::Connection), QuicError> {
    let other = |error: &dyn std::fmt::Display| QuicError::Other(Escaped(error).to_string());
    let socket = bind_udp(any_address_for(address), SOCKET_BUFFER_BYTES).map_err(|error| other(&error))?;
    let runtime = Arc::new(quinn::TokioRuntime);
    let mut endpoint =
        quinn::Endpoint::new(quinn::EndpointConfig::default(), None, socket, runtime).map_err(|error| other(&error))?;
    endpoint.set_default_client_config(config);
    let connecting = endpoint.connect(address, &name).map_err(|error| other(&error))?;
    let connection = connecting.await.map_err(|error| match error {
        quinn::ConnectionError::TimedOut => QuicError::TimedOut,
        error if tls_alert(&error) == Some(quinn::TransportErrorCode::crypto(NO_APPLICATION_PROTOCOL)) => {
            QuicError::Version
        }
        quinn::ConnectionError::VersionMismatch
        | quinn::ConnectionError::TransportError(_)
        | quinn::ConnectionError::ConnectionClosed(_)
        | quinn::ConnectionError::Reset
            if !refused.load(Ordering::Relaxed) =>
        {
            QuicError::Corrupted(Escaped(error).to_string())
        }
        _ if refused.load(Ordering::Relaxed) => QuicError::Certificate,
        error => other(&error),
    })?;
    Ok((endpoint, connection))
}

/// Returns the code by which either end has refused the other's protocols or certificate.
fn tls_alert(error: &quinn::ConnectionError) -> Option<quinn::TransportErrorCode> {
    match error {
        quinn::ConnectionError::ConnectionClosed(close) => Some(close.error_code),
        quinn::ConnectionError::TransportError(error) => Some(error.code),
        _ => None,
    }
}

/// Returns the SHA-256 of the server's certificate.
pub(super) fn certificate_sha256(connection: &quinn::Connection) -> Option<[u8; 32]> {
    let chain = connection.peer_identity()?.downcast::<Vec<CertificateDer<'static>>>().ok()?;
    sha256(chain.first()?)
}

fn config(
    trust: Trust<'_>,
    refused: Arc<AtomicBool>,
) -> Result<quinn::ClientConfig, Box<dyn std::error::Error + Send + Sync>> {
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let builder = rustls::ClientConfig::builder_with_provider(Arc::clone(&provider))
        .with_protocol_versions(&[&rustls::version::TLS13])?;
    let mut tls = match trust {
        Trust::Authority { file, .. } => builder.with_root_certificates(authorities(file)?).with_no_client_auth(),
        Trust::Pinned(_) | Trust::FirstUse => {
            let accepted = if let Trust::Pinned(digests) = trust { Some(digests.to_vec()) } else { None };
            let pinned = Arc::new(Pinned { accepted, provider, refused });
            builder.dangerous().with_custom_certificate_verifier(pinned).with_no_client_auth()
        }
    };
    tls.alpn_protocols = vec![ALPN.to_vec()];
    let mut config = quinn::ClientConfig::new(Arc::new(QuicClientConfig::try_from(tls)?));
    let mut transport = transport_config(IDLE_TIMEOUT, KEEP_ALIVE, INITIAL_WINDOW_BYTES)?;
    transport
        .datagram_receive_buffer_size(Some(DATAGRAM_RECEIVE_BYTES))
        .datagram_send_buffer_size(DATAGRAM_SEND_BYTES)
        .max_concurrent_bidi_streams(0_u32.into())
        .max_concurrent_uni_streams(0_u32.into());
    config.transport_config(Arc::new(transport));
    Ok(config)
}

/// Reads the authorities in a PEM file.
fn authorities(path: &Path) -> Result<rustls::RootCertStore, Box<dyn std::error::Error + Send + Sync>> {
    let unreadable = |error: &dyn std::fmt::Display| format!("{}: {error}", path.display());
    let mut roots = rustls::RootCertStore::empty();
    let pem = read_small(path, MAX_AUTHORITIES_BYTES).map_err(|error| unreadable(&error))?;
    for certificate in CertificateDer::pem_slice_iter(&pem) {
        roots.add(certificate.map_err(|error| unreadable(&error))?).map_err(|error| unreadable(&error))?;
    }
    if roots.is_empty() { Err(unreadable(&"it holds no certificate").into()) } else { Ok(roots) }
}

/// SHA-256, from the library that the handshake uses.
fn sha256(bytes: &[u8]) -> Option<[u8; 32]> {
    let suite = rustls::crypto::ring::cipher_suite::TLS13_AES_128_GCM_SHA256.tls13()?;
    suite.common.hash_provider.hash(bytes).as_ref().try_into().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn digests_are_those_of_fips_180() {
        let digest: String = sha256(b"abc").unwrap().iter().map(|byte| format!("{byte:02x}")).collect();
        assert_eq!(digest, "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
    }

    #[test]
    fn only_the_pinned_certificate_is_accepted() {
        let verify = |accepted| {
            let provider = Arc::new(rustls::crypto::ring::default_provider());
            let pinned = Pinned { accepted, provider, refused: Arc::default() };
            let (leaf, name) = (CertificateDer::from(b"abc".to_vec()), ServerName::try_from("gnomon").unwrap());
            let time = UnixTime::since_unix_epoch(Duration::ZERO);
            let accepted = pinned.verify_server_cert(&leaf, &[], &name, &[], time).is_ok();
            assert_eq!(pinned.refused.load(Ordering::Relaxed), !accepted);
            accepted
        };
        let digest = sha256(b"abc").unwrap();
        let other = digest.map(|byte| byte ^ 1);
        assert!(verify(Some(vec![digest])) && verify(Some(vec![other, digest])));
        assert!(!verify(Some(vec![other])) && !verify(Some(Vec::new())));
        assert!(verify(None), "a first visit");
    }
}
