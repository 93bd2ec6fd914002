//! The files of the page for browsers, from a folder or from within the program.
//!
//! `index.html` names the others as `assets/NAME`. They are served below a folder that is named by the digest of all of
//! them, so that browsers may keep them for good, and never mix two versions.

use std::{
    collections::HashMap,
    io,
    path::{Path, PathBuf},
};

use hyper::body::Bytes;
use thiserror::Error;

use crate::{
    files::read_small,
    limits::{MAX_PAGE_FILE_BYTES, MAX_PAGE_FILES},
};

const INDEX: &str = "index.html";

/// In `index.html`, before each name.
const FOLDER: &str = "assets/";

/// Files with this ending are another file, compressed.
const COMPRESSED: &str = ".gz";

#[derive(Debug, Error)]
pub enum FilesError {
    #[error("--web-root: cannot read {}: {source}", path.display())]
    Read { path: PathBuf, source: io::Error },
    #[error("--web-root {}: there is no index.html; `make web` makes such a folder", .0.display())]
    NoIndex(PathBuf),
    #[error("--web-root {}: more than {MAX_PAGE_FILES} files", .0.display())]
    TooMany(PathBuf),
}

#[derive(Debug)]
pub(crate) struct Files {
    index: Bytes,
    /// Of all files, in hexadecimal.
    digest: String,
    assets: HashMap<String, Asset>,
}

#[derive(Debug)]
pub(super) struct Asset {
    /// Its media type.
    pub(super) kind: &'static str,
    pub(super) plain: Bytes,
    pub(super) compressed: Option<Bytes>,
}

impl Files {
    /// Reads a folder. Files of kinds that no page needs are left out.
    ///
    /// # Errors
    /// If a file cannot be read or is too large, or there is no `index.html`.
    pub(crate) fn read(folder: &Path) -> Result<Self, FilesError> {
        let failed = |path: &Path, source| FilesError::Read { path: path.to_owned(), source };
        let mut files = HashMap::new();
        for entry in std::fs::read_dir(folder).map_err(|source| failed(folder, source))? {
            let path = entry.map_err(|source| failed(folder, source))?.path();
            let Some(name) = path.file_name().and_then(|name| name.to_str()) else { continue };
            if kind(name.strip_suffix(COMPRESSED).unwrap_or(name)).is_none() {
                continue;
            }
            if files.len() >= MAX_PAGE_FILES {
                return Err(FilesError::TooMany(folder.to_owned()));
            }
            let bytes = read_small(&path, MAX_PAGE_FILE_BYTES).map_err(|source| failed(&path, source))?;
            files.insert(name.to_owned(), Bytes::from(bytes));
        }
        Self::of(files).ok_or_else(|| FilesError::NoIndex(folder.to_owned()))
    }

    /// The files within the program; `None` if it was built without them.
    pub(crate) fn built_in() -> Option<Self> {
        #[cfg(feature = "page")]
        {
            let files =
                super::built_in::FILES.iter().map(|(name, bytes)| ((*name).to_owned(), Bytes::from_static(bytes)));
            Self::of(files.collect())
        }
        #[cfg(not(feature = "page"))]
        None
    }

    /// `None` if there is no `index.html`.
    fn of(mut files: HashMap<String, Bytes>) -> Option<Self> {
        let index = files.remove(INDEX)?;
        let mut names: Vec<&String> = files.keys().collect();
        names.sort_unstable();
        let mut hasher = blake3::Hasher::new();
        hasher.update(&index);
        for name in names {
            hasher.update(name.as_bytes());
            hasher.update(blake3::hash(&files[name]).as_bytes());
        }
        let digest: String = hasher.finalize().to_hex().chars().take(16).collect();
        let index = String::from_utf8_lossy(&index).replace(FOLDER, &format!("{digest}/")).into();
        let mut compressed: HashMap<String, Bytes> = HashMap::new();
        files.retain(|name, bytes| match name.strip_suffix(COMPRESSED) {
            Some(name) => {
                compressed.insert(name.to_owned(), bytes.clone());
                false
            }
            None => true,
        });
        let asset = |(name, plain): (String, Bytes)| {
            let kind = kind(&name)?;
            let compressed = compressed.remove(&name);
            Some((name, Asset { kind, plain, compressed }))
        };
        let assets = files.into_iter().filter_map(asset).collect();
        Some(Self { index, digest, assets })
    }

    pub(super) fn index(&self) -> &Bytes {
        &self.index
    }

    pub(super) fn digest(&self) -> &str {
        &self.digest
    }

    /// Returns what a path names: `/DIGEST/NAME`.
    pub(super) fn asset(&self, path: &str) -> Option<&Asset> {
        let name = path.strip_prefix('/')?.strip_prefix(&*self.digest)?.strip_prefix('/')?;
        self.assets.get(name)
    }
}

/// Returns the media type of a page's file; `None` of any other file.
fn kind(name: &str) -> Option<&'static str> {
    Some(match name.rsplit_once('.')?.1 {
        "html" => "text/html; charset=utf-8",
        "css" => "text/css; charset=utf-8",
        "js" => "text/javascript; charset=utf-8",
        "wasm" => "application/wasm",
        "svg" => "image/svg+xml",
        "png" => "image/png",
        _ => return None,
    })
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    pub(in super::super) fn folder() -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        for (name, text) in [
            (INDEX, "<script type=module src=assets/page.js></script>"),
            ("page.js", "import './a.js'"),
            ("page.js.gz", "compressed"),
            ("gnomon_web_bg.wasm", "\0asm"),
            ("notes.txt", "not for the web"),
        ] {
            std::fs::write(folder.path().join(name), text).unwrap();
        }
        folder
    }

    #[test]
    fn files_are_found_below_their_digest_only() {
        let folder = folder();
        let files = Files::read(folder.path()).unwrap();
        let digest = files.digest().to_owned();
        assert_eq!(files.index(), &format!("<script type=module src={digest}/page.js></script>"));
        let asset = files.asset(&format!("/{digest}/page.js")).unwrap();
        assert_eq!(
            (asset.kind, asset.compressed.as_deref()),
            ("text/javascript; charset=utf-8", Some(&b"compressed"[..]))
        );
        assert_eq!(files.asset(&format!("/{digest}/gnomon_web_bg.wasm")).unwrap().kind, "application/wasm");
        for path in ["/page.js", "/assets/page.js", "/0123456789abcdef/page.js"] {
            assert!(files.asset(path).is_none(), "{path}");
        }
        for name in ["", "notes.txt", "page.js.gz", INDEX, "../page.js", "a/page.js"] {
            assert!(files.asset(&format!("/{digest}/{name}")).is_none(), "{name}");
        }
        // Any change makes another digest.
        std::fs::write(folder.path().join("page.js.gz"), "other").unwrap();
        assert_ne!(Files::read(folder.path()).unwrap().digest(), digest);
    }

    #[test]
    fn a_folder_that_is_no_page_is_an_error() {
        let folder = tempfile::tempdir().unwrap();
        let error = |path: &Path| Files::read(path).unwrap_err().to_string();
        assert!(error(folder.path()).contains("no index.html"));
        assert!(error(&folder.path().join("nowhere")).contains("nowhere"));
        std::fs::create_dir(folder.path().join(INDEX)).unwrap();
        assert!(error(folder.path()).contains("not a regular file"));
        std::fs::remove_dir(folder.path().join(INDEX)).unwrap();
        (0..=MAX_PAGE_FILES).for_each(|at| std::fs::write(folder.path().join(format!("{at}.js")), "").unwrap());
        assert!(error(folder.path()).contains("more than"));
    }
}
