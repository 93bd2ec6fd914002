//! Files read with a bound.

use std::{
    fs::File,
    io::Read as _,
    path::{Path, PathBuf},
};

use crate::error::SceneError;

/// Reads a regular file of at most `limit` bytes.
/// Errors if it cannot be read, is no regular file (a pipe would never end), or is larger than `limit`.
pub(crate) fn read_file(path: &Path, limit: u64) -> Result<Vec<u8>, SceneError> {
    let too_large = |bytes| SceneError::FileTooLarge { path: PathBuf::from(path), bytes, limit };
    let there = file_bytes(path)?;
    if there > limit {
        return Err(too_large(there));
    }
    let bytes = read_start(path, limit + 1)?;
    if bytes.len() as u64 > limit {
        return Err(too_large(bytes.len() as u64));
    }
    Ok(bytes)
}

/// Reads the first `most` bytes of a regular file, or all of a shorter one. The rest takes no memory.
/// Errors if it cannot be read, or is no regular file.
pub(crate) fn read_start(path: &Path, most: u64) -> Result<Vec<u8>, SceneError> {
    let expected = file_bytes(path)?.min(most);
    let mut bytes = Vec::with_capacity(usize::try_from(expected).unwrap_or(0));
    File::open(path).and_then(|file| file.take(most).read_to_end(&mut bytes)).map_err(|source| failed(path, source))?;
    Ok(bytes)
}

/// Returns the length of a regular file. Call it before opening: opening a named pipe blocks until it has a writer.
fn file_bytes(path: &Path) -> Result<u64, SceneError> {
    let metadata = std::fs::metadata(path).map_err(|source| failed(path, source))?;
    if !metadata.is_file() {
        return Err(failed(path, std::io::Error::other("not a regular file")));
    }
    Ok(metadata.len())
}

fn failed(path: &Path, source: std::io::Error) -> SceneError {
    SceneError::Read { path: path.to_owned(), source }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folders_and_large_files_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        assert!(matches!(read_file(folder.path(), 10), Err(SceneError::Read { .. })));
        let file = folder.path().join("file");
        std::fs::write(&file, b"12345").unwrap();
        assert_eq!(read_file(&file, 5).unwrap(), b"12345");
        assert!(matches!(read_file(&file, 4), Err(SceneError::FileTooLarge { bytes: 5, limit: 4, .. })));
    }
}
