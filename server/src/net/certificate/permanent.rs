//! The permanent certificate, and the one that will follow.

use std::{path::PathBuf, sync::Arc};

use rustls::{crypto::CryptoProvider, sign::CertifiedKey};

use super::{error::CertificateError, folder::make_unless_kept, pem};

#[derive(Debug, Clone)]
pub(super) struct Permanent {
    pub(super) key: Arc<CertifiedKey>,
    pub(super) sha256: String,
    /// SHA-256 of the announced successor.
    pub(super) next_sha256: Option<String>,
}

/// May hold the certificate that will be the permanent one.
#[derive(Debug)]
pub(super) struct NextFile {
    pub(super) path: PathBuf,
    /// True if the operator named it.
    pub(super) expected: bool,
}

#[derive(Debug)]
pub(super) enum Files {
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
            Self::Operator { certificate, key } => pem::read(certificate, key, provider),
            Self::SelfSigned(path) => {
                make_unless_kept(path)?;
                pem::read(path, path, provider)
            }
        }
    }
}

impl Permanent {
    /// Reads the certificate, and its successor's hash. Errors if a file is unusable or damaged.
    pub(super) fn read(
        files: &Files,
        next: Option<&NextFile>,
        provider: &CryptoProvider,
    ) -> Result<Self, CertificateError> {
        let key = Arc::new(files.read(provider)?);
        let sha256 = pem::leaf_sha256(&key);
        let next_sha256 = next.map(|next| pem::read_next_sha256(&next.path)).transpose()?.flatten();
        if let Some(NextFile { path, .. }) = next.filter(|next| next.expected && next_sha256.is_none()) {
            // No error: it is gone once it has taken its place.
            tracing::warn!(file = %path.display(), "no next certificate: none is announced");
        }
        // After a swap the successor's file may still lie there.
        let next_sha256 = next_sha256.filter(|next| *next != sha256);
        Ok(Self { key, sha256, next_sha256 })
    }
}
