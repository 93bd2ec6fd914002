//! The folder of the self-signed certificate.

use std::path::{Path, PathBuf};

use etcetera::BaseStrategy as _;

use super::{error::CertificateError, pem};
use crate::files;

/// Holds the self-signed certificate and its key.
pub(super) const IDENTITY_FILE: &str = "identity.pem";

/// Its successor, if one was made.
pub(super) const SPARE_FILE: &str = "spare.pem";

/// The configured folder, or `$XDG_STATE_HOME/gnomon-server`, or the system's equivalent.
pub(super) fn folder(configured: Option<&Path>) -> Result<PathBuf, CertificateError> {
    if let Some(configured) = configured {
        return Ok(configured.to_owned());
    }
    let folders = etcetera::choose_base_strategy().map_err(|_| CertificateError::NoFolder)?;
    Ok(folders.state_dir().unwrap_or_else(|| folders.data_dir()).join("gnomon-server"))
}

/// Makes a permanent certificate in `path`, unless there is one. A folder that cannot be written is fine then.
pub(super) fn make_unless_kept(path: &Path) -> Result<(), CertificateError> {
    let failed = |reason| CertificateError::Keep { path: path.to_owned(), reason };
    if path.try_exists().map_err(failed)? {
        return Ok(());
    }
    let pem = pem::make(pem::forever)?;
    path.parent().map_or(Ok(()), std::fs::create_dir_all).map_err(failed)?;
    files::create_private(path, pem.as_bytes()).map(drop).map_err(failed)
}
