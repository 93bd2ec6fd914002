//! Handshakes that complete and then stay silent: each occupies one of the server's handshake slots until it times out.

use std::{
    net::SocketAddr,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};

use anyhow::{Context as _, Result};
use quinn::crypto::rustls::QuicClientConfig;
use rustls::{
    DigitallySignedStruct, Error as TlsError, SignatureScheme,
    client::danger::{HandshakeSignatureValid, ServerCertVerified, ServerCertVerifier},
    crypto::CryptoProvider,
    pki_types::{CertificateDer, ServerName, UnixTime},
};
use tokio::{runtime::Handle, task::JoinSet};

/// An address of this machine that good clients do not use.
const SOURCE: &str = "127.0.0.2:0";

const AT_ONCE: usize = 256;

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

/// Starts up to `handshakes` while `flooding`, and returns how many.
pub(super) fn run(runtime: &Handle, server: SocketAddr, handshakes: u32, flooding: &AtomicBool) -> Result<u32> {
    runtime.block_on(async {
        let provider = Arc::new(rustls::crypto::ring::default_provider());
        let mut tls = rustls::ClientConfig::builder_with_provider(Arc::clone(&provider))
            .with_protocol_versions(&[&rustls::version::TLS13])?
            .dangerous()
            .with_custom_certificate_verifier(Arc::new(Careless(provider)))
            .with_no_client_auth();
        tls.alpn_protocols = vec![b"gnomon/1".to_vec()];
        let config = quinn::ClientConfig::new(Arc::new(QuicClientConfig::try_from(tls)?));
        let mut endpoint = quinn::Endpoint::client(SOURCE.parse()?).context("making the flood's endpoint")?;
        endpoint.set_default_client_config(config);
        let mut tasks = JoinSet::new();
        let mut begun = 0;
        while begun < handshakes && flooding.load(Ordering::Relaxed) {
            if tasks.len() >= AT_ONCE {
                tasks.join_next().await;
            }
            let connecting = endpoint.connect(server, "gnomon")?;
            begun += 1;
            tasks.spawn(async move {
                if let Ok(connection) = connecting.await {
                    // Stays silent until the server closes.
                    let _ = tokio::time::timeout(Duration::from_secs(10), connection.closed()).await;
                }
            });
        }
        while flooding.load(Ordering::Relaxed) {
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
        endpoint.close(0_u32.into(), b"");
        Ok(begun)
    })
}
