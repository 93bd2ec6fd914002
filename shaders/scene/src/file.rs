//! Files read with a bound.

use std::{
    fs::{File, Metadata, OpenOptions},
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
    let file = open_without_waiting(path).map_err(|source| failed(path, source))?;
    regular(path, file.metadata())?;
    file.take(most).read_to_end(&mut bytes).map_err(|source| failed(path, source))?;
    Ok(bytes)
}

/// Returns the length of a regular file. Call it before opening: opening a device may already do something.
fn file_bytes(path: &Path) -> Result<u64, SceneError> {
    regular(path, std::fs::metadata(path))
}

fn regular(path: &Path, metadata: std::io::Result<Metadata>) -> Result<u64, SceneError> {
    let metadata = metadata.map_err(|source| failed(path, source))?;
    if !metadata.is_file() {
        return Err(failed(path, std::io::Error::other("not a regular file")));
    }
    Ok(metadata.len())
}

/// A pipe that has replaced the file meanwhile must not hold the program until it has a writer.
fn open_without_waiting(path: &Path) -> std::io::Result<File> {
    let mut options = OpenOptions::new();
    options.read(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::custom_flags(&mut options, rustix::fs::OFlags::NONBLOCK.bits().cast_signed());
    options.open(path)
}

/// Returns where a file of a scene in `folder` really lies. A link of the scene must stay in the scene's folder: what
/// it leads to travels to every client.
/// Errors if the file does not exist, or lies elsewhere.
pub(crate) fn beneath(path: &Path, folder: &Path) -> Result<PathBuf, SceneError> {
    // A scene file without a folder lies in the current one.
    let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    let real = |path: &Path| std::fs::canonicalize(path).map_err(|source| failed(path, source));
    let (found, folder) = (real(path)?, real(folder)?);
    if found.starts_with(&folder) {
        Ok(found)
    } else {
        let fault = "a link that leaves the scene's folder: copy the file into the folder, or link within it";
        Err(failed(path, std::io::Error::other(fault)))
    }
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

    #[cfg(unix)]
    #[test]
    fn links_stay_in_the_folder_and_pipes_are_not_waited_for() {
        use std::os::unix::fs::symlink;

        let folder = tempfile::tempdir().unwrap();
        let (scene, secret) = (folder.path().join("scene"), folder.path().join("identity.pem"));
        // As Kubernetes mounts a ConfigMap: each file is a link to a link to a folder.
        std::fs::create_dir_all(scene.join("..2026/textures")).unwrap();
        std::fs::write(&secret, b"key").unwrap();
        std::fs::write(scene.join("..2026/a.bin"), b"a").unwrap();
        symlink("..2026", scene.join("..data")).unwrap();
        symlink("..data/a.bin", scene.join("a.bin")).unwrap();
        symlink(scene.join("a.bin"), scene.join("absolute.bin")).unwrap();
        for name in ["a.bin", "absolute.bin", "..2026/a.bin"] {
            let found = beneath(&scene.join(name), &scene).unwrap();
            assert_eq!(read_start(&found, 9).unwrap(), b"a", "{name}");
        }
        symlink("../identity.pem", scene.join("relative.bin")).unwrap();
        symlink(&secret, scene.join("far.bin")).unwrap();
        symlink(folder.path(), scene.join("textures")).unwrap();
        symlink("far.bin", scene.join("twice.bin")).unwrap();
        // Its name begins as the folder's does.
        std::fs::create_dir(folder.path().join("scene2")).unwrap();
        std::fs::write(folder.path().join("scene2/b.bin"), b"b").unwrap();
        symlink("../scene2/b.bin", scene.join("beside.bin")).unwrap();
        for name in ["relative.bin", "far.bin", "textures/identity.pem", "twice.bin", "beside.bin"] {
            let error = beneath(&scene.join(name), &scene).unwrap_err().to_string();
            assert!(error.contains(name) && error.contains("leaves the scene's folder"), "{error}");
        }
        let pipe = scene.join("pipe");
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        symlink("/dev/zero", scene.join("zero")).unwrap();
        for name in ["pipe", "zero"] {
            let error = read_start(&scene.join(name), u64::MAX).unwrap_err().to_string();
            assert!(error.contains("not a regular file"), "{error}");
        }
        drop(open_without_waiting(&pipe).unwrap());
    }
}
