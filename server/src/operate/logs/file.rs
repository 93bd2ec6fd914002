//! Opens log files without waiting: a FIFO without a reader would otherwise stop the server.

use std::{
    fs::{File, OpenOptions},
    io,
    path::Path,
};

/// Opens a file to append to, or creates it. Errors name the path and what to do.
pub(super) fn append(path: &Path) -> io::Result<File> {
    let mut options = OpenOptions::new();
    options.create(true).append(true);
    #[cfg(unix)]
    {
        use std::os::unix::fs::OpenOptionsExt as _;
        options.mode(0o640).custom_flags(libc::O_NONBLOCK | libc::O_NOCTTY | libc::O_CLOEXEC);
    }
    let wrong = |kind, reason: &str| io::Error::new(kind, format!("{}: {reason}", path.display()));
    let file = options.open(path).map_err(|error| {
        if is_without_reader(&error) {
            wrong(error.kind(), "nothing reads this FIFO or device: start its reader first, or log to a file")
        } else {
            wrong(error.kind(), &error.to_string())
        }
    })?;
    if is_writable_kind(&file.metadata()?) {
        return Ok(file);
    }
    Err(wrong(io::ErrorKind::InvalidInput, "is no file, FIFO or character device to log to"))
}

#[cfg(unix)]
fn is_without_reader(error: &io::Error) -> bool {
    error.raw_os_error() == Some(libc::ENXIO)
}

#[cfg(not(unix))]
fn is_without_reader(_: &io::Error) -> bool {
    false
}

#[cfg(unix)]
fn is_writable_kind(file: &std::fs::Metadata) -> bool {
    use std::os::unix::fs::FileTypeExt as _;
    let kind = file.file_type();
    kind.is_file() || kind.is_fifo() || kind.is_char_device()
}

#[cfg(not(unix))]
fn is_writable_kind(file: &std::fs::Metadata) -> bool {
    file.is_file()
}

#[cfg(all(test, unix))]
mod tests {
    use std::process::Command;

    use super::*;

    #[test]
    fn what_cannot_be_logged_to_is_an_error_at_once() {
        let folder = tempfile::tempdir().unwrap();
        let fifo = folder.path().join("fifo");
        assert!(Command::new("mkfifo").arg(&fifo).status().unwrap().success());
        let error = append(&fifo).unwrap_err().to_string();
        assert!(error.contains("fifo") && error.contains("start its reader first"), "{error}");
        let socket = folder.path().join("socket");
        let _bound = std::os::unix::net::UnixListener::bind(&socket).unwrap();
        for path in [folder.path(), &socket, &folder.path().join("none/log")] {
            let error = append(path).unwrap_err().to_string();
            assert!(error.starts_with(&path.display().to_string()), "{error}");
        }
        append(Path::new("/dev/null")).unwrap();
        append(&folder.path().join("log")).unwrap();
    }
}
