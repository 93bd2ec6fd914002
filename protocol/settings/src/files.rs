//! Files that a setting names, read whole and with a bound.

use std::{
    fs::{File, Metadata, OpenOptions},
    io::{self, Read as _},
    path::Path,
};

/// Returns the bytes of a regular file.
///
/// # Errors
/// Errors if the file cannot be read, is no regular file (a pipe would never end, nor would `/dev/zero`), or is longer
/// than `limit_bytes`.
pub fn read_small(path: &Path, limit_bytes: u64) -> io::Result<Vec<u8>> {
    // Looked at first, because opening a device may already do something.
    check_regular(&std::fs::metadata(path)?)?;
    let file = open_without_waiting(path)?;
    check_regular(&file.metadata()?)?;
    read_bounded(file, limit_bytes)
}

/// Returns all bytes up to the end.
///
/// # Errors
/// Errors if reading fails, or more than `limit_bytes` come.
pub fn read_bounded(from: impl io::Read, limit_bytes: u64) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    from.take(limit_bytes.saturating_add(1)).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > limit_bytes {
        return Err(io::Error::new(io::ErrorKind::InvalidData, format!("longer than {limit_bytes} bytes")));
    }
    Ok(bytes)
}

fn check_regular(metadata: &Metadata) -> io::Result<()> {
    if metadata.is_file() { Ok(()) } else { Err(io::Error::other("not a regular file")) }
}

/// A pipe that has replaced the file meanwhile must not hold the program until it has a writer.
fn open_without_waiting(path: &Path) -> io::Result<File> {
    let mut options = OpenOptions::new();
    options.read(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::custom_flags(&mut options, rustix::fs::OFlags::NONBLOCK.bits().cast_signed());
    options.open(path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_regular_files_within_the_bound_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        std::fs::write(&path, b"12345").unwrap();
        assert_eq!(read_small(&path, 5).unwrap(), b"12345");
        assert_eq!(read_small(&path, 4).unwrap_err().to_string(), "longer than 4 bytes");
        assert_eq!(read_small(folder.path(), 4).unwrap_err().to_string(), "not a regular file");
        assert_eq!(read_small(&folder.path().join("b"), 4).unwrap_err().kind(), io::ErrorKind::NotFound);
    }

    #[cfg(unix)]
    #[test]
    fn devices_and_pipes_neither_fill_the_memory_nor_hold_the_program() {
        let folder = tempfile::tempdir().unwrap();
        let pipe = folder.path().join("pipe");
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        let link = folder.path().join("link");
        std::os::unix::fs::symlink("/dev/zero", &link).unwrap();
        for path in [pipe.as_path(), &link, Path::new("/dev/zero")] {
            assert_eq!(read_small(path, u64::MAX).unwrap_err().to_string(), "not a regular file", "{}", path.display());
        }
        // Even if it becomes a pipe after it was looked at.
        drop(open_without_waiting(&pipe).unwrap());
        assert_eq!(read_bounded(io::repeat(0), 1000).unwrap_err().to_string(), "longer than 1000 bytes");
    }
}
