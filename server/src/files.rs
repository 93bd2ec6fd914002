//! Reads files of limited length, and writes files atomically.

use std::{
    fs::{self, OpenOptions},
    io::{self, Write as _},
    path::Path,
    sync::atomic::{AtomicU64, Ordering},
};

pub(crate) use gnomon_settings::files::read_small;

/// Creates a file that only its owner may read, unless it exists. Returns whether it did. A crash leaves no partial
/// key, and two servers that start at once keep the same one. Errors if the folder cannot be written.
pub(crate) fn create_private(path: &Path, bytes: &[u8]) -> io::Result<bool> {
    through_scratch(path, bytes, |scratch| match fs::hard_link(scratch, path) {
        Ok(()) => Ok(true),
        Err(error) if error.kind() == io::ErrorKind::AlreadyExists => Ok(false),
        // The file system lacks hard links. A rename is atomic, too, but may replace another server's file.
        Err(_) => fs::rename(scratch, path).map(|()| true),
    })
}

/// Writes a file that only its owner may read, or replaces it as a whole. Errors if the folder cannot be written.
pub(crate) fn replace_private(path: &Path, bytes: &[u8]) -> io::Result<()> {
    through_scratch(path, bytes, |scratch| fs::rename(scratch, path))
}

fn through_scratch<T>(path: &Path, bytes: &[u8], place: impl FnOnce(&Path) -> io::Result<T>) -> io::Result<T> {
    static SCRATCH: AtomicU64 = AtomicU64::new(0);
    let unique = SCRATCH.fetch_add(1, Ordering::Relaxed);
    let scratch = path.with_extension(format!("{}-{unique}.tmp", std::process::id()));
    let mut options = OpenOptions::new();
    options.write(true).create_new(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    let made = options.open(&scratch).and_then(|mut file| {
        file.write_all(bytes)?;
        file.sync_all()?;
        place(&scratch)
    });
    // Already gone after a rename; harmless if it remains.
    let _ = fs::remove_file(&scratch);
    made
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_are_bounded_and_files_created_once() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        assert!(create_private(&path, b"12345").unwrap());
        assert!(!create_private(&path, b"67890").unwrap(), "the first file stays");
        assert_eq!(read_small(&path, 5).unwrap(), b"12345");
        replace_private(&path, b"67890").unwrap();
        assert_eq!(read_small(&path, 5).unwrap(), b"67890");
        assert_eq!(read_small(&path, 4).unwrap_err().kind(), io::ErrorKind::InvalidData);
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "no scratch file stays");
    }
}
