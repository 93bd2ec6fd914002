//! Packed scenes on disk, by their digest.
//!
//! A scene lies in `DIGEST.scene`, and is only believed when its bytes have that digest. While it is fetched it grows in
//! `DIGEST.part`, which one client at a time holds locked; a fetch that broke off goes on where it stopped. Where the
//! cache cannot be written, clients work without it.

use std::{
    fs::{File, OpenOptions},
    io::{Read as _, Seek as _, SeekFrom, Write as _},
    path::{Path, PathBuf},
};

use etcetera::BaseStrategy as _;
use gnomon_protocol::{ids::SceneDigest, limits::MAX_SCENE_BYTES};
use thiserror::Error;

/// A folder of scenes.
#[derive(Debug, Clone)]
pub struct SceneCache {
    folder: PathBuf,
}

/// Why a scene did not come.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum SceneFetchError {
    /// The server's scene is too large.
    #[error("the server's scene has {0} bytes: at most {MAX_SCENE_BYTES} are accepted")]
    TooLarge(u64),
    /// A piece does not follow the one before it.
    #[error("scene bytes from {found} came where {expected} was next")]
    Gap {
        /// First byte that was missing.
        expected: u64,
        /// First byte that came.
        found: u64,
    },
    /// More bytes than the scene has.
    #[error("the server sent more than the scene's {0} bytes")]
    Overrun(u64),
    /// The bytes are not those of the digest.
    #[error("the server's scene {digest} has the digest {found}: it is not the scene that the server says it traces")]
    Digest {
        /// The digest that the server gave.
        digest: SceneDigest,
        /// The digest of what came.
        found: SceneDigest,
    },
}

/// Whether a scene is in the cache.
#[derive(Debug)]
pub enum SceneFetch {
    /// These are its bytes.
    Whole(Vec<u8>),
    /// It has to be fetched.
    Missing(Fetch),
}

/// A scene that is being fetched.
#[derive(Debug)]
pub struct Fetch {
    cache: SceneCache,
    digest: SceneDigest,
    length: u64,
    bytes: Vec<u8>,
    /// The locked part file; `None` when another client holds it or the cache cannot be written.
    part: Option<File>,
    /// Bytes that an earlier run left.
    resumed: u64,
}

impl SceneCache {
    /// The cache in `folder`, or in the platform's cache directory.
    #[must_use]
    pub fn new(folder: Option<PathBuf>) -> Self {
        let platform = || {
            etcetera::choose_base_strategy().map_or_else(
                |_| std::env::temp_dir().join("gnomon-scenes"),
                |folders| folders.cache_dir().join("gnomon/scenes"),
            )
        };
        Self { folder: folder.unwrap_or_else(platform) }
    }

    /// The folder.
    #[must_use]
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// The file of a scene that has been looked up or fetched, if it is kept.
    #[must_use]
    pub fn kept(&self, digest: SceneDigest) -> Option<PathBuf> {
        Some(self.scene_file(digest)).filter(|file| file.is_file())
    }

    /// Looks for the scene of this digest and length. One whose bytes are not the digest's is removed.
    ///
    /// # Errors
    /// When the length is more than is accepted.
    pub fn look_up(&self, digest: SceneDigest, length: u64) -> Result<SceneFetch, SceneFetchError> {
        if length > MAX_SCENE_BYTES {
            return Err(SceneFetchError::TooLarge(length));
        }
        let file = self.scene_file(digest);
        if let Some(bytes) = read_exactly(&file, length) {
            if digest_of(&bytes) == digest {
                return Ok(SceneFetch::Whole(bytes));
            }
            tracing::warn!(file = %file.display(), "a cached scene is damaged: it is fetched again");
        }
        // Of another length, damaged, or not there at all.
        let _ = std::fs::remove_file(&file);
        let (part, bytes) = match self.open_part(digest, length) {
            Ok((part, bytes)) => (Some(part), bytes),
            Err(reason) => {
                tracing::debug!(%reason, "the scene is fetched without the cache");
                (None, Vec::new())
            }
        };
        let resumed = bytes.len() as u64;
        Ok(SceneFetch::Missing(Fetch { cache: self.clone(), digest, length, bytes, part, resumed }))
    }

    /// Opens and locks the part file, and reads what is in it.
    fn open_part(&self, digest: SceneDigest, length: u64) -> std::io::Result<(File, Vec<u8>)> {
        std::fs::create_dir_all(&self.folder)?;
        let mut options = OpenOptions::new();
        let mut part = options.read(true).write(true).create(true).truncate(false).open(self.part_file(digest))?;
        part.try_lock()?;
        let mut bytes = Vec::new();
        if part.metadata()?.len() <= length {
            (&mut part).take(length).read_to_end(&mut bytes)?;
        } else {
            part.set_len(0)?;
        }
        part.seek(SeekFrom::Start(bytes.len() as u64))?;
        Ok((part, bytes))
    }

    fn scene_file(&self, digest: SceneDigest) -> PathBuf {
        self.folder.join(format!("{digest}.scene"))
    }

    fn part_file(&self, digest: SceneDigest) -> PathBuf {
        self.folder.join(format!("{digest}.part"))
    }
}

impl Fetch {
    /// Bytes that are there.
    #[must_use]
    pub fn have(&self) -> u64 {
        self.bytes.len() as u64
    }

    /// Takes the next piece.
    ///
    /// # Errors
    /// When it does not follow what is there, or there is more than the scene has.
    pub fn append(&mut self, offset: u64, piece: &[u8]) -> Result<(), SceneFetchError> {
        if offset != self.have() {
            return Err(SceneFetchError::Gap { expected: self.have(), found: offset });
        }
        if piece.len() as u64 > self.length - self.have() {
            return Err(SceneFetchError::Overrun(self.length));
        }
        if let Some(part) = &mut self.part
            && let Err(error) = part.write_all(piece)
        {
            tracing::warn!(%error, "the scene cannot be cached");
            self.forget_part();
        }
        self.bytes.extend_from_slice(piece);
        Ok(())
    }

    /// The scene, when its bytes are the digest's; it is then in the cache. `None` when an earlier run's bytes were
    /// damaged: they are forgotten, and everything has to be fetched once more.
    ///
    /// # Errors
    /// When the server's own bytes are not the digest's.
    pub fn finish(&mut self) -> Result<Option<Vec<u8>>, SceneFetchError> {
        let found = digest_of(&self.bytes);
        if found == self.digest {
            if let Err(error) = self.keep() {
                tracing::warn!(%error, folder = %self.cache.folder.display(), "the scene cannot be cached");
            }
            return Ok(Some(std::mem::take(&mut self.bytes)));
        }
        if self.resumed == 0 {
            self.forget_part();
            return Err(SceneFetchError::Digest { digest: self.digest, found });
        }
        self.resumed = 0;
        self.bytes.clear();
        if let Some(part) = &mut self.part
            && part.set_len(0).and_then(|()| part.rewind()).is_err()
        {
            self.forget_part();
        }
        Ok(None)
    }

    /// Makes the part file the scene's. A rename is atomic: nobody ever sees half of a scene.
    fn keep(&mut self) -> std::io::Result<()> {
        let Some(part) = self.part.take() else { return Ok(()) };
        part.sync_data()?;
        std::fs::rename(self.cache.part_file(self.digest), self.cache.scene_file(self.digest))
    }

    fn forget_part(&mut self) {
        if self.part.take().is_some() {
            // What it holds is of no use; if it stays, the next run finds that out.
            let _ = std::fs::remove_file(self.cache.part_file(self.digest));
        }
    }
}

fn digest_of(bytes: &[u8]) -> SceneDigest {
    SceneDigest(*blake3::hash(bytes).as_bytes())
}

/// A file's bytes, if it has exactly so many.
fn read_exactly(file: &Path, length: u64) -> Option<Vec<u8>> {
    let opened = File::open(file).ok()?;
    if opened.metadata().ok()?.len() != length {
        return None;
    }
    let mut bytes = Vec::new();
    opened.take(length).read_to_end(&mut bytes).ok()?;
    (bytes.len() as u64 == length).then_some(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SCENE: &[u8] = b"a packed scene, for all that the cache knows";

    fn missing(cache: &SceneCache) -> Fetch {
        match cache.look_up(digest_of(SCENE), SCENE.len() as u64).unwrap() {
            SceneFetch::Missing(fetch) => fetch,
            SceneFetch::Whole(_) => panic!("it is cached"),
        }
    }

    fn is_cached(cache: &SceneCache) -> bool {
        let found = cache.look_up(digest_of(SCENE), SCENE.len() as u64).unwrap();
        matches!(found, SceneFetch::Whole(bytes) if bytes == SCENE)
    }

    fn fetch_rest(mut fetch: Fetch) -> Option<Vec<u8>> {
        let have = fetch.have();
        fetch.append(have, &SCENE[usize::try_from(have).unwrap()..]).unwrap();
        fetch.finish().unwrap()
    }

    #[test]
    fn a_scene_is_fetched_once() {
        let folder = tempfile::tempdir().unwrap();
        let cache = SceneCache::new(Some(folder.path().join("a/b")));
        assert_eq!(fetch_rest(missing(&cache)).unwrap(), SCENE);
        assert!(is_cached(&cache));
        assert_eq!(std::fs::read_dir(cache.folder()).unwrap().count(), 1);
    }

    #[test]
    fn a_fetch_that_broke_off_goes_on_where_it_stopped() {
        let folder = tempfile::tempdir().unwrap();
        let cache = SceneCache::new(Some(folder.path().into()));
        let mut fetch = missing(&cache);
        fetch.append(0, &SCENE[..10]).unwrap();
        drop(fetch);
        let fetch = missing(&cache);
        assert_eq!(fetch.have(), 10);
        assert_eq!(fetch_rest(fetch).unwrap(), SCENE);
        assert!(is_cached(&cache));
    }

    #[test]
    fn damage_is_noticed_and_mended() {
        let folder = tempfile::tempdir().unwrap();
        let cache = SceneCache::new(Some(folder.path().into()));
        // A damaged scene counts as none.
        fetch_rest(missing(&cache)).unwrap();
        let file = cache.scene_file(digest_of(SCENE));
        let mut bytes = SCENE.to_vec();
        bytes[3] ^= 1;
        std::fs::write(&file, &bytes).unwrap();
        // So does one that is too long for the length.
        let mut fetch = missing(&cache);
        assert_eq!((fetch.have(), file.exists()), (0, false));
        // A damaged part is fetched anew, from its first byte.
        fetch.append(0, &bytes[..20]).unwrap();
        drop(fetch);
        let mut fetch = missing(&cache);
        fetch.append(20, &SCENE[20..]).unwrap();
        assert_eq!(fetch.finish().unwrap(), None);
        assert_eq!(fetch.have(), 0);
        assert_eq!(fetch_rest(fetch).unwrap(), SCENE);
        assert!(is_cached(&cache));
    }

    #[test]
    fn a_server_that_lies_is_found_out() {
        let folder = tempfile::tempdir().unwrap();
        let cache = SceneCache::new(Some(folder.path().into()));
        let mut fetch = missing(&cache);
        assert!(matches!(fetch.append(1, b"x"), Err(SceneFetchError::Gap { expected: 0, found: 1 })));
        assert!(matches!(fetch.append(0, &[0; 45]), Err(SceneFetchError::Overrun(44))));
        fetch.append(0, &[7; 44]).unwrap();
        assert!(matches!(fetch.finish(), Err(SceneFetchError::Digest { .. })));
        drop(fetch);
        assert_eq!(missing(&cache).have(), 0);
        let too_large = cache.look_up(digest_of(SCENE), MAX_SCENE_BYTES + 1).unwrap_err();
        assert_eq!(too_large, SceneFetchError::TooLarge(MAX_SCENE_BYTES + 1));
    }

    #[test]
    fn two_clients_do_not_write_one_part() {
        let folder = tempfile::tempdir().unwrap();
        let cache = SceneCache::new(Some(folder.path().into()));
        let mut first = missing(&cache);
        first.append(0, &SCENE[..5]).unwrap();
        let second = missing(&cache);
        assert_eq!(second.have(), 0);
        assert_eq!(fetch_rest(second).unwrap(), SCENE);
        assert!(!is_cached_without_fetching(&cache));
        assert_eq!(fetch_rest(first).unwrap(), SCENE);
        assert!(is_cached(&cache));
    }

    fn is_cached_without_fetching(cache: &SceneCache) -> bool {
        cache.scene_file(digest_of(SCENE)).exists()
    }

    #[test]
    fn without_a_folder_scenes_still_come() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("not a folder");
        std::fs::write(&file, b"").unwrap();
        assert_eq!(fetch_rest(missing(&SceneCache::new(Some(file)))).unwrap(), SCENE);
    }
}
