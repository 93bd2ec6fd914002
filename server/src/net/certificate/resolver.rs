//! Chooses a certificate for each handshake.

use std::{sync::Arc, time::Duration};

use parking_lot::Mutex;
use rustls::{
    crypto::CryptoProvider,
    server::{ClientHello, ResolvesServerCert},
    sign::CertifiedKey,
};

use super::{
    browser::{BrowserCertificates, BrowserHashes},
    error::CertificateError,
    folder::{IDENTITY_FILE, SPARE_FILE, folder},
    permanent::{Files, NextFile, Permanent},
};
use crate::{clock, config::ServerConfig};

pub(crate) const ALPN_WEB: &[u8] = b"h3";

/// A renewal is late by at most this.
const RENEWAL_CHECK: Duration = Duration::from_secs(1);

/// Chooses a certificate by the client's ALPN.
#[derive(Debug)]
pub(crate) struct Certificates {
    files: Files,
    next_file: Option<NextFile>,
    permanent: Mutex<Permanent>,
    /// `None` if browsers trust the permanent one.
    browser: Option<BrowserCertificates>,
    provider: Arc<CryptoProvider>,
}

impl Certificates {
    /// Reads or makes the permanent certificate. Errors if the folder or file is unusable or damaged.
    pub(crate) fn open(config: &ServerConfig, provider: Arc<CryptoProvider>) -> Result<Self, CertificateError> {
        let (files, spare, folder) = match (&config.cert_file, &config.key_file) {
            (Some(certificate), Some(key)) => {
                (Files::Operator { certificate: certificate.clone(), key: key.clone() }, None, None)
            }
            _ => {
                let folder = folder(config.cert_dir.as_deref())?;
                let [identity, spare] = [IDENTITY_FILE, SPARE_FILE].map(|name| folder.join(name));
                (Files::SelfSigned(identity), Some(spare), Some(folder))
            }
        };
        let named = config.next_cert_file.clone().map(|path| NextFile { path, expected: true });
        let next_file = named.or(spare.map(|path| NextFile { path, expected: false }));
        let permanent = Mutex::new(Permanent::read(&files, next_file.as_ref(), &provider)?);
        let browser = folder
            .map(|folder| BrowserCertificates::open(&folder, clock::wall(), Arc::clone(&provider)))
            .transpose()?;
        Ok(Self { files, next_file, permanent, browser, provider })
    }

    /// Rereads the permanent certificate for later handshakes, and its successor. An unusable one changes nothing.
    /// Errors as [`Self::open`].
    pub(crate) fn reload(&self) -> Result<(), CertificateError> {
        let read = Permanent::read(&self.files, self.next_file.as_ref(), &self.provider)?;
        *self.permanent.lock() = read;
        Ok(())
    }

    /// SHA-256 of the permanent certificate, in hexadecimal.
    pub(crate) fn permanent_sha256(&self) -> String {
        self.permanent.lock().sha256.clone()
    }

    /// SHA-256 of the certificate that will be the permanent one, in hexadecimal.
    pub(crate) fn next_sha256(&self) -> Option<String> {
        self.permanent.lock().next_sha256.clone()
    }

    /// What browsers pin; `None` if they trust the permanent certificate's authority.
    pub(crate) fn browser_hashes(&self) -> Option<BrowserHashes> {
        self.browser.as_ref().map(|browser| browser.hashes(clock::wall()))
    }

    /// Renews the browsers' certificates by the clock, so that their hashes are right before a browser comes.
    pub(crate) async fn keep_fresh(self: Arc<Self>) {
        loop {
            tokio::time::sleep(RENEWAL_CHECK).await;
            self.browser_hashes();
        }
    }
}

impl ResolvesServerCert for Certificates {
    fn resolve(&self, hello: ClientHello<'_>) -> Option<Arc<CertifiedKey>> {
        let native = hello.alpn().is_some_and(|mut offered| offered.any(|alpn| alpn == gnomon_transport::quic::ALPN));
        Some(match self.browser.as_ref().filter(|_| !native) {
            Some(browser) => browser.key(clock::wall()),
            None => Arc::clone(&self.permanent.lock().key),
        })
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::net::certificate::{
        commands::{make_identity, make_spare, use_spare},
        pem,
    };

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
        let next = folder.path().join("next.pem");
        // Both files hold certificate and key, of which each lends one.
        let write = || {
            let pem = pem::make(pem::forever).unwrap();
            std::fs::write(&chain, &pem).unwrap();
            std::fs::write(&key, &pem).unwrap();
        };
        write();
        let config = ServerConfig {
            cert_file: Some(chain.clone()),
            key_file: Some(key.clone()),
            next_cert_file: Some(next.clone()),
            ..ServerConfig::default()
        };
        let certificates = Certificates::open(&config, provider()).unwrap();
        let first = certificates.permanent_sha256();
        assert_eq!(certificates.browser_hashes(), None, "browsers trust its authority");
        certificates.reload().unwrap();
        assert_eq!((certificates.permanent_sha256(), certificates.next_sha256()), (first.clone(), None));
        let pem = pem::make(pem::forever).unwrap();
        std::fs::write(&next, &pem).unwrap();
        certificates.reload().unwrap();
        let announced = certificates.next_sha256().unwrap();
        assert_eq!(certificates.permanent_sha256(), first);
        std::fs::copy(&next, &chain).unwrap();
        std::fs::copy(&next, &key).unwrap();
        certificates.reload().unwrap();
        assert_eq!((certificates.permanent_sha256(), certificates.next_sha256()), (announced.clone(), None));
        std::fs::write(&next, "half a certif").unwrap();
        assert!(matches!(certificates.reload(), Err(CertificateError::Next { .. })));
        std::fs::remove_file(&next).unwrap();
        write();
        certificates.reload().unwrap();
        let second = certificates.permanent_sha256();
        assert_ne!(announced, second);
        // The key of another certificate: half a rotation, which the next SIGHUP completes.
        std::fs::write(&key, pem::make(pem::forever).unwrap()).unwrap();
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
        assert_eq!(first.browser_hashes(), second.browser_hashes());
        assert!(first.browser_hashes().is_some());
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
        let [one, other] = [(); 2].map(|()| pem::make(pem::forever).unwrap());
        let halves = |pem: &str| pem.split_once("-----BEGIN PRIVATE").map(|(first, _)| first.len()).unwrap();
        let ((certificate, key), (_, other_key)) = (one.split_at(halves(&one)), other.split_at(halves(&other)));
        for text in [
            String::new(),
            "garbage".to_owned(),
            certificate.to_owned(),
            key.to_owned(),
            certificate.to_owned() + other_key,
        ] {
            std::fs::write(&path, &text).unwrap();
            let error = open(folder.path()).unwrap_err();
            assert!(matches!(error, CertificateError::Damaged { .. }), "{text:?}: {error}");
            assert_eq!(std::fs::read_to_string(&path).unwrap(), text);
        }
        std::fs::write(&path, one).unwrap();
        open(folder.path()).unwrap();
    }

    #[test]
    fn a_spare_is_announced_and_then_used() {
        let folder = tempfile::tempdir().unwrap();
        let dir = Some(folder.path());
        let ours = make_identity(dir).unwrap();
        assert_eq!(make_identity(dir).unwrap(), ours, "the first one stays");
        assert!(matches!(use_spare(dir), Err(CertificateError::NoSpare(_))));
        let certificates = open(folder.path()).unwrap();
        assert_eq!((certificates.permanent_sha256(), certificates.next_sha256()), (ours.clone(), None));
        let spare = make_spare(dir).unwrap();
        assert_eq!(make_spare(dir).unwrap(), spare, "what was announced stays");
        certificates.reload().unwrap();
        assert_eq!((certificates.permanent_sha256(), certificates.next_sha256()), (ours, Some(spare.clone())));
        assert_eq!(use_spare(dir).unwrap(), spare);
        certificates.reload().unwrap();
        assert_eq!((certificates.permanent_sha256(), certificates.next_sha256()), (spare.clone(), None));
        let next = make_spare(dir).unwrap();
        std::fs::write(folder.path().join(SPARE_FILE), "-----BEGIN").unwrap();
        assert!(matches!(use_spare(dir), Err(CertificateError::Damaged { .. })));
        assert!(matches!(open(folder.path()), Err(CertificateError::Next { .. })));
        assert_ne!(next, spare);
    }

    /// As Kubernetes mounts a Secret. Root writes into such a folder all the same, so that only others are tested.
    #[cfg(unix)]
    #[test]
    fn an_identity_in_a_folder_that_cannot_be_written_is_used() {
        use std::os::unix::fs::{PermissionsExt as _, symlink};

        let mount = tempfile::tempdir().unwrap();
        let ours = make_identity(Some(&mount.path().join("..2026"))).unwrap();
        symlink("..2026", mount.path().join("..data")).unwrap();
        symlink("..data/identity.pem", mount.path().join(IDENTITY_FILE)).unwrap();
        let mode = |mode| std::fs::set_permissions(mount.path(), std::fs::Permissions::from_mode(mode)).unwrap();
        mode(0o555);
        let certificates = open(mount.path()).unwrap();
        mode(0o755);
        assert_eq!(certificates.permanent_sha256(), ours);
        assert!(certificates.browser_hashes().is_some());
        // Where even root cannot write.
        let missing = open(Path::new("/proc/self")).unwrap_err();
        assert!(missing.to_string().contains("--cert-dir"), "{missing}");
    }
}
