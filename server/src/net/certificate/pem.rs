//! Makes certificates, and reads them from PEM.

use std::{io, path::Path};

use rcgen::{CertificateParams, DistinguishedName, DnType, KeyPair, date_time_ymd};
use rustls::{
    crypto::CryptoProvider,
    pki_types::{CertificateDer, PrivateKeyDer, pem::PemObject as _},
    sign::CertifiedKey,
};

use super::error::CertificateError;
use crate::{files, hex, limits};

/// Makes a self-signed P-256 certificate and its key, in PEM. Its name is arbitrary, since clients pin it.
pub(super) fn make(life: impl FnOnce(&mut CertificateParams)) -> Result<String, CertificateError> {
    let attempt = move || {
        let mut params = CertificateParams::new(["gnomon".to_owned(), "localhost".to_owned()])?;
        params.distinguished_name = DistinguishedName::new();
        params.distinguished_name.push(DnType::CommonName, "gnomon-server");
        life(&mut params);
        let key = KeyPair::generate()?;
        Ok(params.self_signed(&key)?.pem() + &key.serialize_pem())
    };
    attempt().map_err(|error: rcgen::Error| CertificateError::Make(error.to_string()))
}

/// Sets no end, by the date that RFC 5280, 4.1.2.5, defines for that.
pub(super) fn forever(params: &mut CertificateParams) {
    params.not_before = date_time_ymd(2000, 1, 1);
    params.not_after = date_time_ymd(9999, 12, 31);
}

/// Reads a chain and its key, from one or two files.
pub(super) fn read(
    certificate: &Path,
    key: &Path,
    provider: &CryptoProvider,
) -> Result<CertifiedKey, CertificateError> {
    let (chain, key) = (read_file(certificate)?, read_file(key)?);
    certified(&chain, &key, provider)
        .map_err(|reason| CertificateError::Damaged { path: certificate.to_owned(), reason })
}

/// Reads the SHA-256 of the next certificate, which needs no key. `None` if there is no file.
pub(super) fn read_next_sha256(path: &Path) -> Result<Option<String>, CertificateError> {
    let pem = match read_file(path) {
        Err(CertificateError::File { reason, .. }) if reason.kind() == io::ErrorKind::NotFound => return Ok(None),
        pem => pem?,
    };
    let chain = chain(&pem).map_err(|reason| CertificateError::Next { path: path.to_owned(), reason })?;
    Ok(chain.first().map(|leaf| sha256(leaf)))
}

fn read_file(path: &Path) -> Result<Vec<u8>, CertificateError> {
    files::read_small(path, limits::MAX_SMALL_FILE_BYTES)
        .map_err(|reason| CertificateError::File { path: path.to_owned(), reason })
}

/// Errors, with the reason, unless both are there and belong together.
pub(super) fn certified(chain_pem: &[u8], key_pem: &[u8], provider: &CryptoProvider) -> Result<CertifiedKey, String> {
    let chain = chain(chain_pem)?;
    let key = PrivateKeyDer::from_pem_slice(key_pem).map_err(|error| format!("key: {error}"))?;
    // Also checks that the key matches the certificate.
    CertifiedKey::from_der(chain, key, provider).map_err(|error| error.to_string())
}

fn chain(pem: &[u8]) -> Result<Vec<CertificateDer<'static>>, String> {
    let chain: Vec<_> = CertificateDer::pem_slice_iter(pem)
        .collect::<Result<_, _>>()
        .map_err(|error| format!("certificate: {error}"))?;
    if chain.is_empty() { Err("no certificate".to_owned()) } else { Ok(chain) }
}

/// SHA-256 in hexadecimal.
fn sha256(certificate: &CertificateDer<'_>) -> String {
    hex::encode(ring::digest::digest(&ring::digest::SHA256, certificate).as_ref())
}

pub(super) fn leaf_sha256(key: &CertifiedKey) -> String {
    key.cert.first().map_or_else(String::new, sha256)
}
