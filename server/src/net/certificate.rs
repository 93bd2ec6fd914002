//! TLS identity: a permanent certificate for native clients, and a short-lived one for browsers.
//!
//! The permanent one belongs to the operator (`cert_file`, `key_file`), and clients trust its CA; or else it is
//! self-signed. Clients pin a self-signed one by its SHA-256 in the server's URL, as SSH pins a host key. So it is made
//! once, never expires, and stays in `identity.pem`; delete the file to get another. SIGHUP reloads the files for later
//! handshakes; sessions keep their keys.
//!
//! A browser accepts a pinned certificate (`serverCertificateHashes`) only if it is valid for at most 14 days and has a
//! P-256 key. So a handshake that offers `h3` gets a second certificate. It is valid for 13 days, stays in memory, and
//! is renewed after half of that. Web pages ask the server for its hash anyway.

use std::{
    path::{Path, PathBuf},
    sync::Arc,
    time::{Duration, SystemTime, UNIX_EPOCH},
};

use etcetera::BaseStrategy as _;
use parking_lot::Mutex;
use rcgen::{CertificateParams, DistinguishedName, DnType, KeyPair, date_time_ymd};
use rustls::{
    crypto::CryptoProvider,
    pki_types::{CertificateDer, PrivateKeyDer, PrivatePkcs8KeyDer, pem::PemObject as _},
    server::{ClientHello, ResolvesServerCert},
    sign::CertifiedKey,
};
use thiserror::Error;

use crate::{clock, config::ServerConfig, files, hex, limits};

/// Holds the self-signed certificate and its key.
const IDENTITY_FILE: &str = "identity.pem";

pub(crate) const ALPN_WEB: &[u8] = b"h3";

const BROWSER_LIFE: Duration = Duration::from_secs(13 * 24 * 3600);

/// Tolerates browsers whose clocks are slow.
const BROWSER_BACKDATE: Duration = Duration::from_secs(3600);

#[derive(Debug, Error)]
pub enum CertificateError {
    /// No folder is configured, and the user has no home.
    #[error("no folder to keep the certificate in: pass --cert-dir DIR")]
    NoFolder,
    #[error("cannot keep the certificate in {path}: {reason}; pass another --cert-dir DIR")]
    File { path: PathBuf, reason: std::io::Error },
    #[error("{path} holds no usable certificate and key ({reason}): repair it, or delete it to get a new certificate")]
    Damaged { path: PathBuf, reason: String },
    #[error("cannot make a certificate: {0}")]
    Make(String),
}

/// Chooses a certificate by the client's ALPN.
#[derive(Debug)]
pub(crate) struct Certificates {
    files: Files,
    permanent: Mutex<Arc<CertifiedKey>>,
    browser: Mutex<BrowserCertificate>,
    provider: Arc<CryptoProvider>,
}

#[derive(Debug)]
enum Files {
    Operator {
        certificate: PathBuf,
        key: PathBuf,
    },
    /// Self-signed, made if it does not exist.
    SelfSigned(PathBuf),
}

impl Files {
    fn read(&self, provider: &CryptoProvider) -> Result<CertifiedKey, CertificateError> {
        match self {
            Self::Operator { certificate, key } => read(certificate, key, provider),
            Self::SelfSigned(path) => {
                if !path.exists() {
                    let (certificate, key) = make(forever)?;
                    let pem = certificate.pem() + &key.serialize_pem();
                    files::create_private(path, pem.as_bytes())
                        .map_err(|reason| CertificateError::File { path: path.clone(), reason })?;
                }
                read(path, path, provider)
            }
        }
    }
}

#[derive(Debug)]
struct BrowserCertificate {
    key: Arc<CertifiedKey>,
    /// Start of validity. Matters if the clock is set back.
    begins_at: SystemTime,
    renew_at: SystemTime,
}

impl Certificates {
    /// Reads or makes the permanent certificate. Errors if the folder or file is unusable or damaged.
    pub(crate) fn open(config: &ServerConfig, provider: Arc<CryptoProvider>) -> Result<Self, CertificateError> {
        let files = match (&config.cert_file, &config.key_file) {
            (Some(certificate), Some(key)) => Files::Operator { certificate: certificate.clone(), key: key.clone() },
            _ => {
                let folder = config.cert_dir.clone().or_else(default_folder).ok_or(CertificateError::NoFolder)?;
                std::fs::create_dir_all(&folder)
                    .map_err(|reason| CertificateError::File { path: folder.clone(), reason })?;
                Files::SelfSigned(folder.join(IDENTITY_FILE))
            }
        };
        let permanent = Mutex::new(Arc::new(files.read(&provider)?));
        let browser = Mutex::new(BrowserCertificate::make(&provider, clock::wall())?);
        Ok(Self { files, permanent, browser, provider })
    }

    /// Rereads the permanent certificate for later handshakes, and returns its SHA-256. An unusable one changes
    /// nothing. Errors as [`Self::open`].
    pub(crate) fn reload(&self) -> Result<String, CertificateError> {
        let read = Arc::new(self.files.read(&self.provider)?);
        *self.permanent.lock() = read;
        Ok(self.permanent_sha256())
    }

    fn permanent(&self) -> Arc<CertifiedKey> {
        Arc::clone(&self.permanent.lock())
    }

    /// SHA-256 of the permanent certificate, in hexadecimal.
    pub(crate) fn permanent_sha256(&self) -> String {
        self.sha256(&self.permanent())
    }

    /// SHA-256 of the browsers' current certificate, in hexadecimal.
    pub(crate) fn browser_sha256(&self) -> String {
        self.sha256(&self.browser_key(clock::wall()))
    }

    fn sha256(&self, key: &CertifiedKey) -> String {
        key.cert.first().map_or_else(String::new, |leaf| {
            let digest = web_transport_quinn::crypto::sha256(&self.provider, leaf);
            hex::encode(digest.as_ref())
        })
    }

    fn browser_key(&self, now: SystemTime) -> Arc<CertifiedKey> {
        let mut browser = self.browser.lock();
        if now >= browser.renew_at || now < browser.begins_at {
            match BrowserCertificate::make(&self.provider, now) {
                Ok(renewed) => *browser = renewed,
                // The old one stays valid for days, and the next handshake retries.
                Err(error) => tracing::error!(%error, "cannot renew the browsers' certificate"),
            }
        }
        Arc::clone(&browser.key)
    }
}

impl ResolvesServerCert for Certificates {
    fn resolve(&self, hello: ClientHello<'_>) -> Option<Arc<CertifiedKey>> {
        let native = hello.alpn().is_some_and(|mut offered| offered.any(|alpn| alpn == gnomon_transport::quic::ALPN));
        Some(if native { self.permanent() } else { self.browser_key(clock::wall()) })
    }
}

impl BrowserCertificate {
    fn make(provider: &CryptoProvider, now: SystemTime) -> Result<Self, CertificateError> {
        let not_before = now
            .duration_since(UNIX_EPOCH)
            .ok()
            .and_then(|since_epoch| since_epoch.checked_sub(BROWSER_BACKDATE))
            .map(|since_epoch| date_time_ymd(1970, 1, 1) + since_epoch)
            .ok_or_else(|| CertificateError::Make("the system's clock is before 1970".to_owned()))?;
        let (certificate, key) = make(|params| {
            params.not_before = not_before;
            params.not_after = not_before + BROWSER_LIFE;
        })?;
        let key = PrivateKeyDer::Pkcs8(PrivatePkcs8KeyDer::from(key.serialize_der()));
        let key = CertifiedKey::from_der(vec![certificate.der().clone()], key, provider)
            .map_err(|error| CertificateError::Make(error.to_string()))?;
        Ok(Self { key: Arc::new(key), begins_at: now - BROWSER_BACKDATE, renew_at: now + BROWSER_LIFE / 2 })
    }
}

/// Makes a self-signed P-256 certificate. Its name is arbitrary, since clients pin it.
fn make(life: impl FnOnce(&mut CertificateParams)) -> Result<(rcgen::Certificate, KeyPair), CertificateError> {
    let attempt = move || {
        let mut params = CertificateParams::new(["gnomon".to_owned(), "localhost".to_owned()])?;
        params.distinguished_name = DistinguishedName::new();
        params.distinguished_name.push(DnType::CommonName, "gnomon-server");
        life(&mut params);
        let key = KeyPair::generate()?;
        Ok((params.self_signed(&key)?, key))
    };
    attempt().map_err(|error: rcgen::Error| CertificateError::Make(error.to_string()))
}

/// Sets no end, by the date that RFC 5280, 4.1.2.5, defines for that.
fn forever(params: &mut CertificateParams) {
    params.not_before = date_time_ymd(2000, 1, 1);
    params.not_after = date_time_ymd(9999, 12, 31);
}

/// Reads a chain and its key, from one or two files.
fn read(certificate: &Path, key: &Path, provider: &CryptoProvider) -> Result<CertifiedKey, CertificateError> {
    let damaged = |reason: String| CertificateError::Damaged { path: certificate.to_owned(), reason };
    let read = |path: &Path| {
        files::read_small(path, limits::MAX_SMALL_FILE_BYTES)
            .map_err(|reason| CertificateError::File { path: path.to_owned(), reason })
    };
    let (pem, key_pem) = (read(certificate)?, read(key)?);
    let chain: Vec<_> = CertificateDer::pem_slice_iter(&pem)
        .collect::<Result<_, _>>()
        .map_err(|error| damaged(format!("certificate: {error}")))?;
    if chain.is_empty() {
        return Err(damaged("no certificate in it".to_owned()));
    }
    let key = PrivateKeyDer::from_pem_slice(&key_pem).map_err(|error| damaged(format!("key: {error}")))?;
    // Also checks that the key matches the certificate.
    CertifiedKey::from_der(chain, key, provider).map_err(|error| damaged(error.to_string()))
}

/// `$XDG_STATE_HOME/gnomon-server`, or the system's equivalent.
fn default_folder() -> Option<PathBuf> {
    let folders = etcetera::choose_base_strategy().ok()?;
    Some(folders.state_dir().unwrap_or_else(|| folders.data_dir()).join("gnomon-server"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn provider() -> Arc<CryptoProvider> {
        Arc::new(rustls::crypto::ring::default_provider())
    }

    fn open(folder: &Path) -> Result<Certificates, CertificateError> {
        let config = ServerConfig { cert_dir: Some(folder.to_owned()), ..ServerConfig::default() };
        Certificates::open(&config, provider())
    }

    #[test]
    fn given_files_are_shown_and_read_again() {
        let folder = tempfile::tempdir().unwrap();
        let [chain, key] = ["chain.pem", "key.pem"].map(|name| folder.path().join(name));
        let write = || {
            let (certificate, private) = make(forever).unwrap();
            std::fs::write(&chain, certificate.pem()).unwrap();
            std::fs::write(&key, private.serialize_pem()).unwrap();
        };
        write();
        let config =
            ServerConfig { cert_file: Some(chain.clone()), key_file: Some(key.clone()), ..ServerConfig::default() };
        let certificates = Certificates::open(&config, provider()).unwrap();
        let first = certificates.permanent_sha256();
        assert_eq!(certificates.reload().unwrap(), first);
        write();
        let second = certificates.reload().unwrap();
        assert_ne!(first, second);
        // The key of another certificate: half a rotation, which the next SIGHUP completes.
        std::fs::write(&key, KeyPair::generate().unwrap().serialize_pem()).unwrap();
        assert!(matches!(certificates.reload(), Err(CertificateError::Damaged { .. })));
        assert_eq!(certificates.permanent_sha256(), second);
    }

    #[test]
    fn the_certificate_is_kept_and_its_key_is_private() {
        let folder = tempfile::tempdir().unwrap();
        let nested = folder.path().join("a/b");
        let first = open(&nested).unwrap();
        let second = open(&nested).unwrap();
        assert_eq!(first.permanent_sha256(), second.permanent_sha256());
        assert_eq!(first.permanent_sha256().len(), 64);
        assert_ne!(first.browser_sha256(), second.browser_sha256());
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt as _;
            let mode = std::fs::metadata(nested.join(IDENTITY_FILE)).unwrap().permissions().mode();
            assert_eq!(mode & 0o777, 0o600);
        }
        std::fs::remove_file(nested.join(IDENTITY_FILE)).unwrap();
        let third = open(&nested).unwrap();
        assert_ne!(first.permanent_sha256(), third.permanent_sha256());
    }

    #[test]
    fn a_damaged_file_is_named_and_never_overwritten() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(IDENTITY_FILE);
        let (certificate, key) = make(forever).unwrap();
        let other = KeyPair::generate().unwrap();
        for text in [
            String::new(),
            "garbage".to_owned(),
            certificate.pem(),
            key.serialize_pem(),
            certificate.pem() + &other.serialize_pem(),
        ] {
            std::fs::write(&path, &text).unwrap();
            let error = open(folder.path()).unwrap_err();
            assert!(matches!(error, CertificateError::Damaged { .. }), "{text:?}: {error}");
            assert_eq!(std::fs::read_to_string(&path).unwrap(), text);
        }
        std::fs::write(&path, certificate.pem() + &key.serialize_pem()).unwrap();
        open(folder.path()).unwrap();
    }

    #[test]
    fn the_browsers_certificate_is_renewed_while_the_server_runs() {
        let folder = tempfile::tempdir().unwrap();
        let certificates = open(folder.path()).unwrap();
        let now = SystemTime::now();
        let first = certificates.browser_key(now);
        assert!(Arc::ptr_eq(&first, &certificates.browser_key(now + BROWSER_LIFE / 3)));
        let renewed = certificates.browser_key(now + BROWSER_LIFE / 2 + Duration::from_secs(60));
        assert!(!Arc::ptr_eq(&first, &renewed));
        // The clock was set back, so a browser would find the certificate not yet valid. A small step is tolerated.
        assert!(Arc::ptr_eq(&renewed, &certificates.browser_key(now + BROWSER_LIFE / 2)));
        assert!(!Arc::ptr_eq(&renewed, &certificates.browser_key(now)));
        assert!(BROWSER_LIFE <= Duration::from_secs(14 * 24 * 3600), "browsers refuse longer lives");
    }
}
