//! The files of the scene cache: opened without following a link, and removed, oldest first, when there are too many.

use std::{
    fmt,
    fs::{self, File, OpenOptions},
    io,
    path::{Path, PathBuf},
    time::SystemTime,
};

/// What [`clear`] removed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Cleared {
    pub folder: PathBuf,
    pub files: usize,
    pub bytes: u64,
    /// Files that another client is fetching right now, or that cannot be removed.
    pub kept: usize,
}

impl fmt::Display for Cleared {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let megabytes = self.bytes as f64 / 1e6;
        write!(f, "removed {} cached scenes ({megabytes:.1} MB) from {}", self.files, self.folder.display())?;
        if self.kept > 0 {
            write!(f, "; {} are in use, or cannot be removed", self.kept)?;
        }
        Ok(())
    }
}

/// Creates the folder, which only this user may read.
pub(super) fn create(folder: &Path) -> io::Result<()> {
    let mut builder = fs::DirBuilder::new();
    builder.recursive(true);
    #[cfg(unix)]
    std::os::unix::fs::DirBuilderExt::mode(&mut builder, 0o700);
    builder.create(folder)
}

/// Opens a file for reading, and also for writing if it is `created`. In a folder that others may write, a link would
/// lead to any file of this user, and a pipe would never end.
pub(super) fn open(path: &Path, created: bool) -> io::Result<File> {
    let mut options = OpenOptions::new();
    options.read(true).write(created).create(created).truncate(false);
    #[cfg(unix)]
    {
        use std::os::unix::fs::OpenOptionsExt as _;
        let flags = rustix::fs::OFlags::NOFOLLOW | rustix::fs::OFlags::NONBLOCK;
        options.mode(0o600).custom_flags(flags.bits().cast_signed());
    }
    let file = options.open(path)?;
    if file.metadata()?.is_file() { Ok(file) } else { Err(io::Error::other("not a regular file")) }
}

/// Removes those scenes that were not used for longest, until all have at most `limit_bytes`. The scene in use stays.
pub(super) fn shrink(folder: &Path, limit_bytes: u64, in_use: &Path) -> io::Result<()> {
    let mut entries = entries(folder)?;
    entries.sort_by_key(|entry| entry.used_at);
    let mut total: u64 = entries.iter().map(|entry| entry.bytes).sum();
    for entry in entries.iter().filter(|entry| entry.path != in_use) {
        if total <= limit_bytes {
            break;
        }
        if entry.remove() {
            tracing::debug!(file = %entry.path.display(), bytes = entry.bytes, "removed from the cache");
            total -= entry.bytes;
        }
    }
    Ok(())
}

/// Removes all scenes. Other files of the folder stay.
pub(super) fn clear(folder: &Path) -> io::Result<Cleared> {
    let mut cleared = Cleared { folder: folder.to_owned(), files: 0, bytes: 0, kept: 0 };
    for entry in entries(folder)? {
        if entry.remove() {
            cleared.files += 1;
            cleared.bytes += entry.bytes;
        } else {
            cleared.kept += 1;
        }
    }
    Ok(cleared)
}

struct Entry {
    path: PathBuf,
    bytes: u64,
    used_at: SystemTime,
}

impl Entry {
    /// Returns whether the file is gone. A part that another client is fetching stays.
    fn remove(&self) -> bool {
        let is_part = self.path.extension().is_some_and(|extension| extension == "part");
        let is_locked = || open(&self.path, false).is_ok_and(|part| part.try_lock().is_err());
        !(is_part && is_locked()) && fs::remove_file(&self.path).is_ok()
    }
}

/// Lists the cache's own files, known by their names. A folder that does not exist has none.
fn entries(folder: &Path) -> io::Result<Vec<Entry>> {
    let listed = match fs::read_dir(folder) {
        Ok(listed) => listed,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(error) => return Err(error),
    };
    let mut entries = Vec::new();
    for entry in listed {
        let entry = entry?;
        // Of the link itself, if it is one. Another client may have removed the file meanwhile.
        let Ok(metadata) = entry.metadata() else { continue };
        if is_of_cache(&entry.path()) && !metadata.is_dir() {
            let used_at = metadata.modified().unwrap_or(SystemTime::UNIX_EPOCH);
            entries.push(Entry { path: entry.path(), bytes: metadata.len(), used_at });
        }
    }
    Ok(entries)
}

fn is_of_cache(path: &Path) -> bool {
    let parts = (path.file_stem().and_then(|stem| stem.to_str()), path.extension().and_then(|it| it.to_str()));
    let (Some(stem), Some("scene" | "part")) = parts else { return false };
    stem.len() == 64 && stem.bytes().all(|byte| byte.is_ascii_hexdigit())
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    fn name(folder: &Path, digit: char, extension: &str) -> PathBuf {
        folder.join(String::from(digit).repeat(64)).with_extension(extension)
    }

    /// Writes a file that was used this many seconds ago.
    fn write(path: &Path, bytes: usize, seconds_ago: u64) {
        fs::write(path, vec![0; bytes]).unwrap();
        let file = File::options().write(true).open(path).unwrap();
        file.set_modified(SystemTime::now() - Duration::from_secs(seconds_ago)).unwrap();
    }

    #[test]
    fn the_scenes_used_last_stay_within_the_limit() {
        let folder = tempfile::tempdir().unwrap();
        let [a, b, c, d] = ['a', 'b', 'c', 'd'].map(|digit| name(folder.path(), digit, "scene"));
        let (part, other) = (name(folder.path(), 'e', "part"), folder.path().join("notes.scene"));
        for (path, seconds_ago) in [(&a, 90), (&b, 20), (&c, 30), (&d, 10), (&part, 80), (&other, 99)] {
            write(path, 100, seconds_ago);
        }
        let left = |limit, in_use: &Path| {
            shrink(folder.path(), limit, in_use).unwrap();
            [&a, &b, &c, &d, &part, &other].map(|path| path.exists())
        };
        assert_eq!(left(500, &d), [true; 6]);
        assert_eq!(left(300, &a), [true, true, false, true, false, true], "the oldest ones beside the one in use go");
        assert_eq!(left(0, &a), [true, false, false, false, false, true]);
    }

    #[test]
    fn clearing_removes_scenes_only_and_none_that_is_being_fetched() {
        let folder = tempfile::tempdir().unwrap();
        let [scene, part] = ["scene", "part"].map(|extension| name(folder.path(), 'a', extension));
        let (fetched, other) = (name(folder.path(), 'b', "part"), folder.path().join("holiday.png"));
        for path in [&scene, &part, &fetched, &other] {
            write(path, 1_500_000, 0);
        }
        let client = open(&fetched, true).unwrap();
        client.try_lock().unwrap();
        let cleared = clear(folder.path()).unwrap();
        assert_eq!((cleared.files, cleared.bytes, cleared.kept), (2, 3_000_000, 1));
        let said = format!("removed 2 cached scenes (3.0 MB) from {}; 1 are in use", folder.path().display());
        assert!(cleared.to_string().starts_with(&said), "{cleared}");
        assert!(fetched.exists() && other.exists() && !scene.exists());
        assert_eq!(clear(&folder.path().join("none")).unwrap().files, 0);
    }

    #[cfg(unix)]
    #[test]
    fn links_and_pipes_are_not_opened() {
        let folder = tempfile::tempdir().unwrap();
        let [target, link, pipe] = ["target", "link", "pipe"].map(|name| folder.path().join(name));
        fs::write(&target, b"mine").unwrap();
        std::os::unix::fs::symlink(&target, &link).unwrap();
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        for path in [&link, &pipe] {
            assert!(open(path, false).is_err() && open(path, true).is_err(), "{}", path.display());
        }
        assert_eq!(fs::read(&target).unwrap(), b"mine");
        create(&folder.path().join("new/cache")).unwrap();
        let made = fs::metadata(folder.path().join("new/cache")).unwrap();
        assert_eq!(std::os::unix::fs::PermissionsExt::mode(&made.permissions()) & 0o777, 0o700);
    }
}
