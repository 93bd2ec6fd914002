use std::{io, path::PathBuf};

use thiserror::Error;

#[derive(Debug, Error)]
pub enum CertificateError {
    /// No folder is configured, and the user has no home.
    #[error("no folder to keep the certificate in: pass --cert-dir DIR")]
    NoFolder,
    #[error("cannot keep the certificate in {path}: {reason}; pass another --cert-dir DIR")]
    Keep { path: PathBuf, reason: io::Error },
    #[error("cannot read the certificate {path}: {reason}")]
    File { path: PathBuf, reason: io::Error },
    #[error("{path} holds no usable certificate and key ({reason}): repair it, or delete it to get a new certificate")]
    Damaged { path: PathBuf, reason: String },
    #[error("{path} holds no certificate ({reason}): repair it, or delete it to announce no next certificate")]
    Next { path: PathBuf, reason: String },
    #[error("cannot make a certificate: {0}")]
    Make(String),
    #[error("there is no {0} to use: make one with `gnomon-server certificate spare`")]
    NoSpare(PathBuf),
}
