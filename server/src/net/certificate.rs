//! Who the server is: one certificate that is kept, and one for browsers that is not.
//!
//! The kept one is the operator's, from `cert_file` and `key_file`, or self-made. A native client trusts the CA of the one, or pins
//! the other: it pins the SHA-256 of the certificate that the server's URL names, as SSH pins a host key. So that
//! certificate is made once, never expires, and stays in `identity.pem`; delete the file to get another one. SIGHUP reads the files again, and
//! the next handshake shows what is in them; sessions keep the keys that they have agreed on.
//!
//! A browser accepts a pinned certificate (`serverCertificateHashes`) only when it lives for at most 14 days and has a
//! P-256 key. So a handshake that offers `h3` gets a second certificate, which lives in memory for 13 days and is
//! replaced, while the server runs, once half of that has passed. A page has to ask for its hash anyway.

use std::{
    path::{Path, PathBuf},
    sync::{Arc, Mutex, PoisonError},
    time::{Duration, SystemTime, UNIX_EPOCH},
};

use etcetera::BaseStrategy as _;
use rcgen::{CertificateParams, DistinguishedName, DnType, KeyPair, date_time_ymd};
use rustls::{
    crypto::CryptoProvider,
    pki_types::{CertificateDer, PrivateKeyDer, PrivatePkcs8KeyDer, pem::PemObject as _},
    server::{ClientHello, ResolvesServerCert},
    sign::CertifiedKey,
};
use thiserror::Error;

use crate::{clock, config::ServerConfig, files, limits};

/// The file of the kept certificate and its key.
const IDENTITY_FILE: &str = "identity.pem";

/// ALPN of WebTransport.
pub(crate) const ALPN_WEB: &[u8] = b"h3";

const BROWSER_LIFE: Duration = Duration::from_secs(13 * 24 * 3600);

/// Clocks differ: the browser's certificate is already an hour old.
const BROWSER_BACKDATE: Duration = Duration::from_secs(3600);

/// Why there is no certificate.
#[derive(Debug, Error)]
pub enum CertificateError {
    /// No folder was configured, and the user has no home.
    #[error("no folder to keep the certificate in: pass --cert-dir DIR")]
    NoFolder,
    /// The folder or file cannot be read or written.
    #[error("cannot keep the certificate in {path}: {reason}; pass another --cert-dir DIR")]
    File {
        /// The folder or file.
        path: PathBuf,
        /// Why.
        reason: std::io::Error,
    },
    /// The file is there, but it holds no certificate with its key.
    #[error("{path} holds no usable certificate and key ({reason}): mend it, or delete it to get a new certificate")]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// No certificate could be made.
    #[error("cannot make a certificate: {0}")]
    Make(String),
}

/// The certificates of a server, by what a client's handshake offers.
#[derive(Debug)]
pub(crate) struct Certificates {
    files: Files,
    kept: Mutex<Arc<CertifiedKey>>,
    browser: Mutex<BrowserCertificate>,
    provider: Arc<CryptoProvider>,
}

/// Where the kept certificate comes from.
#[derive(Debug)]
enum Files {
    /// The operator's.
    Given { certificate: PathBuf, key: PathBuf },
    /// Ours, made where there is none.
    Made(PathBuf),
}

impl Files {
    fn read(&self, provider: &CryptoProvider) -> Result<CertifiedKey, CertificateError> {
        match self {
            Self::Given { certificate, key } => read(certificate, key, provider),
            Self::Made(path) => {
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
    /// It is not valid yet before, as when the clock was set back.
    begins_at: SystemTime,
    renew_at: SystemTime,
}

impl Certificates {
    /// Opens the kept certificate, or makes it where there is none.
    ///
    /// # Errors
    /// When the folder or file cannot be used, or its content is damaged.
    pub(crate) fn open(config: &ServerConfig, provider: Arc<CryptoProvider>) -> Result<Self, CertificateError> {
        let files = match (&config.cert_file, &config.key_file) {
            (Some(certificate), Some(key)) => Files::Given { certificate: certificate.clone(), key: key.clone() },
            _ => {
                let folder = config.cert_dir.clone().or_else(default_folder).ok_or(CertificateError::NoFolder)?;
                std::fs::create_dir_all(&folder)
                    .map_err(|reason| CertificateError::File { path: folder.clone(), reason })?;
                Files::Made(folder.join(IDENTITY_FILE))
            }
        };
        let kept = Mutex::new(Arc::new(files.read(&provider)?));
        let browser = Mutex::new(BrowserCertificate::make(&provider, clock::wall())?);
        Ok(Self { files, kept, browser, provider })
    }

    /// Reads the kept certificate again, for the handshakes to come; says its SHA-256. One that cannot be used changes nothing.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub(crate) fn reload(&self) -> Result<String, CertificateError> {
        let read = Arc::new(self.files.read(&self.provider)?);
        *self.kept.lock().unwrap_or_else(PoisonError::into_inner) = read;
        Ok(self.kept_sha256())
    }

    fn kept(&self) -> Arc<CertifiedKey> {
        Arc::clone(&self.kept.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// SHA-256 of the kept certificate, in hexadecimal.
    pub(crate) fn kept_sha256(&self) -> String {
        self.sha256(&self.kept())
    }

    /// SHA-256 of the certificate that browsers see now, in hexadecimal.
    pub(crate) fn browser_sha256(&self) -> String {
        self.sha256(&self.browser_key(clock::wall()))
    }

    fn sha256(&self, key: &CertifiedKey) -> String {
        key.cert.first().map_or_else(String::new, |leaf| {
            let digest = web_transport_quinn::crypto::sha256(&self.provider, leaf);
            digest.as_ref().iter().map(|byte| format!("{byte:02x}")).collect()
        })
    }

    fn browser_key(&self, now: SystemTime) -> Arc<CertifiedKey> {
        let mut browser = self.browser.lock().unwrap_or_else(PoisonError::into_inner);
        if now >= browser.renew_at || now < browser.begins_at {
            match BrowserCertificate::make(&self.provider, now) {
                Ok(renewed) => *browser = renewed,
                // The old one is still good for days, and the next handshake tries again.
                Err(error) => tracing::error!(%error, "cannot renew the browsers' certificate"),
            }
        }
        Arc::clone(&browser.key)
    }
}

impl ResolvesServerCert for Certificates {
    fn resolve(&self, hello: ClientHello<'_>) -> Option<Arc<CertifiedKey>> {
        let native = hello.alpn().is_some_and(|mut offered| offered.any(|alpn| alpn == gnomon_transport::quic::ALPN));
        Some(if native { self.kept() } else { self.browser_key(clock::wall()) })
    }
}

impl BrowserCertificate {
    fn make(provider: &CryptoProvider, now: SystemTime) -> Result<Self, CertificateError> {
        let not_before = now
            .duration_since(UNIX_EPOCH)
            .ok()
            .and_then(|since_epoch| since_epoch.checked_sub(BROWSER_BACKDATE))
            .map(|since_epoch| date_time_ymd(1970, 1, 1) + since_epoch)
            .ok_or_else(|| CertificateError::Make("the system's clock stands before 1970".to_owned()))?;
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

/// A self-signed P-256 certificate: clients pin it, whatever name they reach the server by.
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

/// No end: RFC 5280 (4.1.2.5) has this date for it.
fn forever(params: &mut CertificateParams) {
    params.not_before = date_time_ymd(2000, 1, 1);
    params.not_after = date_time_ymd(9999, 12, 31);
}

/// A chain and its key, from two files or from one.
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
    // This also checks that the key belongs to the certificate.
    CertifiedKey::from_der(chain, key, provider).map_err(|error| damaged(error.to_string()))
}

/// `$XDG_STATE_HOME/gnomon-server`, or what the system has in its place.
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
        let first = certificates.kept_sha256();
        assert_eq!(certificates.reload().unwrap(), first);
        write();
        let second = certificates.reload().unwrap();
        assert_ne!(first, second);
        // The key of another certificate: half a rotation, which the next SIGHUP completes.
        std::fs::write(&key, KeyPair::generate().unwrap().serialize_pem()).unwrap();
        assert!(matches!(certificates.reload(), Err(CertificateError::Damaged { .. })));
        assert_eq!(certificates.kept_sha256(), second);
    }

    #[test]
    fn the_certificate_is_kept_and_its_key_is_private() {
        let folder = tempfile::tempdir().unwrap();
        let nested = folder.path().join("a/b");
        let first = open(&nested).unwrap();
        let second = open(&nested).unwrap();
        assert_eq!(first.kept_sha256(), second.kept_sha256());
        assert_eq!(first.kept_sha256().len(), 64);
        assert_ne!(first.browser_sha256(), second.browser_sha256());
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt as _;
            let mode = std::fs::metadata(nested.join(IDENTITY_FILE)).unwrap().permissions().mode();
            assert_eq!(mode & 0o777, 0o600);
        }
        std::fs::remove_file(nested.join(IDENTITY_FILE)).unwrap();
        let third = open(&nested).unwrap();
        assert_ne!(first.kept_sha256(), third.kept_sha256());
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
        // The clock was set back: a browser would say that it is not valid yet. A little is within its age.
        assert!(Arc::ptr_eq(&renewed, &certificates.browser_key(now + BROWSER_LIFE / 2)));
        assert!(!Arc::ptr_eq(&renewed, &certificates.browser_key(now)));
        assert!(BROWSER_LIFE <= Duration::from_secs(14 * 24 * 3600), "browsers refuse longer lives");
    }
}
