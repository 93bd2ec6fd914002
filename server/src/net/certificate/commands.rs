//! What an operator does in the folder of the self-signed certificate. Hashes are SHA-256, in hexadecimal.

use std::path::Path;

use super::{
    browser,
    error::CertificateError,
    folder::{IDENTITY_FILE, SPARE_FILE, folder, make_unless_kept},
    pem,
};
use crate::{clock, config::ServerConfig};

/// Makes the permanent certificate, unless there is one: for a deployment that mounts it read-only.
///
/// # Errors
/// If the folder cannot be written, or the file is damaged.
pub fn make_identity(cert_dir: Option<&Path>) -> Result<String, CertificateError> {
    made(&folder(cert_dir)?.join(IDENTITY_FILE))
}

/// Makes the certificate that will follow, unless there is one. The next start or SIGHUP announces it in the URL.
///
/// # Errors
/// As [`make_identity`].
pub fn make_spare(cert_dir: Option<&Path>) -> Result<String, CertificateError> {
    made(&folder(cert_dir)?.join(SPARE_FILE))
}

/// Puts the spare certificate into the place of the permanent one. The next start or SIGHUP uses it.
///
/// # Errors
/// If there is none, it is damaged, or the folder cannot be written.
pub fn use_spare(cert_dir: Option<&Path>) -> Result<String, CertificateError> {
    let folder = folder(cert_dir)?;
    let [identity, spare] = [IDENTITY_FILE, SPARE_FILE].map(|name| folder.join(name));
    if !spare.exists() {
        return Err(CertificateError::NoSpare(spare));
    }
    let sha256 = sha256(&spare)?;
    std::fs::rename(&spare, &identity).map_err(|reason| CertificateError::Keep { path: identity, reason })?;
    Ok(sha256)
}

fn made(path: &Path) -> Result<String, CertificateError> {
    make_unless_kept(path)?;
    sha256(path)
}

fn sha256(path: &Path) -> Result<String, CertificateError> {
    Ok(pem::leaf_sha256(&pem::read(path, path, &rustls::crypto::ring::default_provider())?))
}

/// The hashes that a server with this configuration shows browsers now. Changes nothing; `None` if it has not run yet,
/// or has the operator's certificate.
#[must_use]
pub fn kept_browser_hashes(config: &ServerConfig) -> Option<serde_json::Value> {
    let folder = config.cert_file.is_none().then(|| folder(config.cert_dir.as_deref()).ok())??;
    let hashes = browser::kept_hashes(&folder, clock::wall(), &rustls::crypto::ring::default_provider())?;
    serde_json::to_value(hashes).ok()
}
