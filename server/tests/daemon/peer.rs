//! A peer of either protocol, from any loopback address, that sends what it likes.

use std::{
    net::{IpAddr, SocketAddr},
    sync::Arc,
};

use quinn::crypto::rustls::QuicClientConfig;
use rustls::{
    DigitallySignedStruct, SignatureScheme,
    client::danger::{HandshakeSignatureValid, ServerCertVerified, ServerCertVerifier},
    crypto::CryptoProvider,
    pki_types::{CertificateDer, ServerName, UnixTime},
};
use web_transport_quinn::{Session, SessionError, WebTransportError};

use super::{client::Control, soon};

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Protocol {
    Native,
    Web,
}

impl Protocol {
    pub(crate) const BOTH: [Self; 2] = [Self::Native, Self::Web];

    const fn alpn(self) -> &'static [u8] {
        match self {
            Self::Native => b"gnomon/1",
            Self::Web => b"h3",
        }
    }
}

/// Takes any certificate: these tests are about other things.
#[derive(Debug)]
struct Careless(Arc<CryptoProvider>);

impl ServerCertVerifier for Careless {
    fn verify_server_cert(
        &self,
        _end_entity: &CertificateDer<'_>,
        _intermediates: &[CertificateDer<'_>],
        _server_name: &ServerName<'_>,
        _ocsp_response: &[u8],
        _now: UnixTime,
    ) -> Result<ServerCertVerified, rustls::Error> {
        Ok(ServerCertVerified::assertion())
    }

    fn verify_tls12_signature(
        &self,
        _message: &[u8],
        _certificate: &CertificateDer<'_>,
        _signature: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, rustls::Error> {
        Ok(HandshakeSignatureValid::assertion())
    }

    fn verify_tls13_signature(
        &self,
        _message: &[u8],
        _certificate: &CertificateDer<'_>,
        _signature: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, rustls::Error> {
        Ok(HandshakeSignatureValid::assertion())
    }

    fn supported_verify_schemes(&self) -> Vec<SignatureScheme> {
        self.0.signature_verification_algorithms.supported_schemes()
    }
}

/// An endpoint at this address.
pub(crate) fn endpoint(from: IpAddr, protocol: Protocol) -> quinn::Endpoint {
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let mut tls = rustls::ClientConfig::builder_with_provider(Arc::clone(&provider))
        .with_protocol_versions(&[&rustls::version::TLS13])
        .unwrap()
        .dangerous()
        .with_custom_certificate_verifier(Arc::new(Careless(provider)))
        .with_no_client_auth();
    tls.alpn_protocols = vec![protocol.alpn().to_vec()];
    let mut endpoint = quinn::Endpoint::client((from, 0).into()).unwrap();
    let config = QuicClientConfig::try_from(tls).unwrap();
    endpoint.set_default_client_config(quinn::ClientConfig::new(Arc::new(config)));
    endpoint
}

/// Completes QUIC's handshake, and nothing more.
pub(crate) async fn connect(
    endpoint: &quinn::Endpoint,
    server: SocketAddr,
) -> Result<quinn::Connection, quinn::ConnectionError> {
    soon(endpoint.connect(server, "localhost").unwrap()).await
}

/// Opens a session as far as it goes without a control stream.
pub(crate) async fn session(connection: quinn::Connection, protocol: Protocol) -> Session {
    match protocol {
        Protocol::Native => Session::raw(connection),
        Protocol::Web => {
            let url = url::Url::parse(&format!("https://{}/", connection.remote_address())).unwrap();
            soon(Session::connect(connection, url)).await.unwrap()
        }
    }
}

pub(crate) async fn control(session: &Session) -> Control {
    let (send, receive) = soon(session.open_bi()).await.unwrap();
    Control::new(receive, send)
}

/// Code and reason with which the server closes.
pub(crate) async fn closed(session: &Session) -> (u32, String) {
    match soon(session.closed()).await {
        SessionError::WebTransportError(WebTransportError::Closed(code, reason)) => (code, reason),
        other => panic!("closed without code and reason: {other:?}"),
    }
}
