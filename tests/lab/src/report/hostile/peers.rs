//! Peers that speak QUIC, and what they like from there on.

use std::{net::SocketAddr, sync::Arc, time::Duration};

use anyhow::{Context as _, Result};
use quinn::crypto::rustls::QuicClientConfig;
use rustls::{
    DigitallySignedStruct, Error as TlsError, SignatureScheme,
    client::danger::{HandshakeSignatureValid, ServerCertVerified, ServerCertVerifier},
    crypto::CryptoProvider,
    pki_types::{CertificateDer, ServerName, UnixTime},
};
use web_transport_quinn::proto;

use super::addresses::Addresses;

/// Longest wait for a handshake, which the server may have to evict first.
const CONNECTS_WITHIN: Duration = Duration::from_secs(10);

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Protocol {
    Native,
    Web,
}

impl Protocol {
    pub(super) const BOTH: [Self; 2] = [Self::Native, Self::Web];

    pub(super) const fn alpn(self) -> &'static str {
        match self {
            Self::Native => "gnomon/1",
            Self::Web => "h3",
        }
    }
}

/// One endpoint for each address to attack from.
pub(super) struct Peers {
    endpoints: Vec<(quinn::Endpoint, SocketAddr)>,
}

impl Peers {
    /// Must be called on a runtime.
    pub(super) fn new(addresses: &Addresses, protocol: Protocol) -> Result<Self> {
        let provider = Arc::new(rustls::crypto::ring::default_provider());
        let mut tls = rustls::ClientConfig::builder_with_provider(Arc::clone(&provider))
            .with_protocol_versions(&[&rustls::version::TLS13])?
            .dangerous()
            .with_custom_certificate_verifier(Arc::new(Careless(provider)))
            .with_no_client_auth();
        tls.alpn_protocols = vec![protocol.alpn().into()];
        let mut config = quinn::ClientConfig::new(Arc::new(QuicClientConfig::try_from(tls)?));
        let mut transport = quinn::TransportConfig::default();
        transport.keep_alive_interval(Some(Duration::from_secs(1)));
        config.transport_config(Arc::new(transport));
        let endpoint = |(from, to)| {
            let mut endpoint = quinn::Endpoint::client((from, 0).into()).with_context(|| format!("using {from}"))?;
            endpoint.set_default_client_config(config.clone());
            Ok((endpoint, to))
        };
        Ok(Self { endpoints: addresses.pairs().map(endpoint).collect::<Result<_>>()? })
    }

    /// Completes a handshake from one address after the other.
    pub(super) async fn connect(&self, number: usize) -> Result<quinn::Connection> {
        let (endpoint, server) = &self.endpoints[number % self.endpoints.len()];
        let connecting = endpoint.connect(*server, "gnomon")?;
        Ok(tokio::time::timeout(CONNECTS_WITHIN, connecting).await??)
    }

    pub(super) fn close(&self) {
        for (endpoint, _) in &self.endpoints {
            endpoint.close(0_u32.into(), b"");
        }
    }
}

/// Streams of an HTTP/3 connection with an accepted WebTransport session. Dropping one resets it.
pub(super) struct WebStreams {
    pub(super) request: quinn::SendStream,
    _answer: quinn::RecvStream,
    _settings: quinn::SendStream,
}

/// Opens a WebTransport session by hand, to send what no library sends.
pub(super) async fn web_session(connection: &quinn::Connection) -> Result<WebStreams> {
    let mut settings = proto::Settings::default();
    settings.enable_webtransport(1);
    let mut control = connection.open_uni().await?;
    settings.write(&mut control).await?;
    let (mut request, mut answer) = connection.open_bi().await?;
    proto::ConnectRequest::new(url::Url::parse("https://gnomon/")?).write(&mut request).await?;
    proto::ConnectResponse::read(&mut answer).await?;
    Ok(WebStreams { request, _answer: answer, _settings: control })
}

/// Takes any certificate.
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
    ) -> Result<ServerCertVerified, TlsError> {
        Ok(ServerCertVerified::assertion())
    }

    fn verify_tls12_signature(
        &self,
        _message: &[u8],
        _certificate: &CertificateDer<'_>,
        _signature: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, TlsError> {
        Ok(HandshakeSignatureValid::assertion())
    }

    fn verify_tls13_signature(
        &self,
        _message: &[u8],
        _certificate: &CertificateDer<'_>,
        _signature: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, TlsError> {
        Ok(HandshakeSignatureValid::assertion())
    }

    fn supported_verify_schemes(&self) -> Vec<SignatureScheme> {
        self.0.signature_verification_algorithms.supported_schemes()
    }
}
