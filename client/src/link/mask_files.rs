//! Files written by `--save-masks` and `--mask-log` for tests and measurements.

use std::{
    fs::File,
    io::Write as _,
    path::{Path, PathBuf},
    sync::Arc,
};

use gnomon_client_core::mask::digest::digest;
use gnomon_protocol::{mask::Mask, receive::ReceivedFrame};
use parking_lot::Mutex;

use super::receive_options::Reception;
use crate::error::ClientError;

/// Why a file could not be written: the receive task puts it there, and the run ends with it.
pub(crate) type FileFailure = Arc<Mutex<Option<ClientError>>>;

#[derive(Debug)]
pub(crate) struct MaskFiles {
    /// Folder for the body of each complete frame.
    bodies: Option<PathBuf>,
    log: Option<(PathBuf, File)>,
}

impl MaskFiles {
    /// Opens the files that `reception` names. Returns `None` if it names none.
    pub(crate) fn open(reception: &Reception) -> Result<Option<Self>, ClientError> {
        let Reception { save_masks, mask_log, .. } = reception;
        let open = |path: &PathBuf| match File::options().append(true).open(path) {
            Ok(file) => Ok((path.clone(), file)),
            Err(source) => Err(ClientError::Write { path: path.clone(), source }),
        };
        let log = mask_log.as_ref().map(open).transpose()?;
        Ok((save_masks.is_some() || log.is_some()).then(|| Self { bodies: save_masks.clone(), log }))
    }

    /// # Errors
    /// Errors if a file cannot be written. A truncated body is removed.
    pub(crate) fn write(&mut self, received: &ReceivedFrame<'_>, mask: &Mask) -> Result<(), ClientError> {
        let failed = |path: &Path, source| ClientError::Write { path: path.into(), source };
        let &ReceivedFrame { frame, packets, restored, missing, body, .. } = received;
        if let Some(folder) = self.bodies.as_ref().filter(|_| received.is_whole) {
            let path = folder.join(format!("frame_{:06}.body", frame.0));
            std::fs::write(&path, body).map_err(|error| {
                let _ = std::fs::remove_file(&path);
                failed(&path, error)
            })?;
        }
        if let Some((path, file)) = &mut self.log {
            let digest = digest(mask);
            let written = writeln!(file, "{frame} {packets} {restored} {missing} {digest}");
            written.map_err(|error| failed(path, error))?;
        }
        Ok(())
    }
}
