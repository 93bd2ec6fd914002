//! A disk cache of packed scenes, keyed by digest.
//!
//! `DIGEST.scene` is used only if its bytes have that digest. A scene being fetched grows in `DIGEST.part`, which one
//! client at a time holds locked. An interrupted fetch resumes where it stopped. If the cache cannot be written,
//! clients work without it.

use std::{
    fs::{File, OpenOptions},
    io::{Read as _, Seek as _, SeekFrom, Write as _},
    path::{Path, PathBuf},
};

use etcetera::BaseStrategy as _;
use gnomon_protocol::{ids::SceneDigest, limits::MAX_SCENE_BYTES};
use thiserror::Error;

#[derive(Debug, Clone)]
pub struct SceneCache {
    folder: PathBuf,
}

#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum SceneFetchError {
    /// The scene exceeds [`MAX_SCENE_BYTES`].
    #[error("the server's scene has {0} bytes: at most {MAX_SCENE_BYTES} are accepted")]
    TooLarge(u64),
    /// A chunk does not follow the previous one.
    #[error("a scene chunk starts at byte {found}, expected byte {expected}")]
    Gap { expected: u64, found: u64 },
    /// The server sent more bytes than it announced.
    #[error("the server sent more than the scene's {0} bytes")]
    Overrun(u64),
    /// The bytes have another digest.
    #[error("the server announced the scene {digest} and sent {found}")]
    Digest { digest: SceneDigest, found: SceneDigest },
}

/// Result of a cache look-up.
#[derive(Debug)]
pub enum CachedScene {
    Whole(Vec<u8>),
    /// The rest has to be fetched.
    Missing(SceneFetch),
}

#[derive(Debug)]
pub struct SceneFetch {
    cache: SceneCache,
    digest: SceneDigest,
    length: u64,
    bytes: Vec<u8>,
    /// The locked part file; `None` if another client holds it or the cache cannot be written.
    part: Option<File>,
    /// Bytes from an earlier run.
    resumed: u64,
}

impl SceneCache {
    /// Uses `folder`, or the platform's cache directory.
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

    #[must_use]
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Returns the file of a scene that was looked up or fetched before, if it is cached.
    #[must_use]
    pub fn cached_file(&self, digest: SceneDigest) -> Option<PathBuf> {
        Some(self.scene_file(digest)).filter(|file| file.is_file())
    }

    /// Looks up the scene with this digest and length, and removes it if its bytes have another digest.
    ///
    /// # Errors
    /// Errors if `length` exceeds [`MAX_SCENE_BYTES`].
    pub fn look_up(&self, digest: SceneDigest, length: u64) -> Result<CachedScene, SceneFetchError> {
        if length > MAX_SCENE_BYTES {
            return Err(SceneFetchError::TooLarge(length));
        }
        let file = self.scene_file(digest);
        if let Some(bytes) = read_exactly(&file, length) {
            if digest_of(&bytes) == digest {
                return Ok(CachedScene::Whole(bytes));
            }
            tracing::warn!(file = %file.display(), "a cached scene is damaged: fetching it again");
        }
        // Another length, damaged, or missing.
        let _ = std::fs::remove_file(&file);
        let (part, bytes) = match self.open_part(digest, length) {
            Ok((part, bytes)) => (Some(part), bytes),
            Err(reason) => {
                tracing::debug!(%reason, "fetching the scene without the cache");
                (None, Vec::new())
            }
        };
        let resumed = bytes.len() as u64;
        Ok(CachedScene::Missing(SceneFetch { cache: self.clone(), digest, length, bytes, part, resumed }))
    }

    /// Opens and locks the part file, and reads it.
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

impl SceneFetch {
    /// Returns the bytes fetched so far.
    #[must_use]
    pub fn fetched(&self) -> u64 {
        self.bytes.len() as u64
    }

    /// Appends the next chunk.
    ///
    /// # Errors
    /// Errors if `offset` is not the next byte, or the scene gets too long.
    pub fn append(&mut self, offset: u64, chunk: &[u8]) -> Result<(), SceneFetchError> {
        if offset != self.fetched() {
            return Err(SceneFetchError::Gap { expected: self.fetched(), found: offset });
        }
        if chunk.len() as u64 > self.length - self.fetched() {
            return Err(SceneFetchError::Overrun(self.length));
        }
        if let Some(part) = &mut self.part
            && let Err(error) = part.write_all(chunk)
        {
            tracing::warn!(%error, "cannot cache the scene");
            self.discard_part();
        }
        self.bytes.extend_from_slice(chunk);
        Ok(())
    }

    /// Returns the scene and caches it. Returns `None` if bytes from an earlier run were damaged; they are discarded,
    /// and the whole scene must be fetched again.
    ///
    /// # Errors
    /// Errors if the server sent another scene.
    pub fn finish(&mut self) -> Result<Option<Vec<u8>>, SceneFetchError> {
        let found = digest_of(&self.bytes);
        if found == self.digest {
            if let Err(error) = self.store() {
                tracing::warn!(%error, folder = %self.cache.folder.display(), "cannot cache the scene");
            }
            return Ok(Some(std::mem::take(&mut self.bytes)));
        }
        if self.resumed == 0 {
            self.discard_part();
            return Err(SceneFetchError::Digest { digest: self.digest, found });
        }
        self.resumed = 0;
        self.bytes.clear();
        if let Some(part) = &mut self.part
            && part.set_len(0).and_then(|()| part.rewind()).is_err()
        {
            self.discard_part();
        }
        Ok(None)
    }

    /// Renames the part file. A rename is atomic, so no client sees half a scene.
    fn store(&mut self) -> std::io::Result<()> {
        let Some(part) = self.part.take() else { return Ok(()) };
        part.sync_data()?;
        std::fs::rename(self.cache.part_file(self.digest), self.cache.scene_file(self.digest))
    }

    fn discard_part(&mut self) {
        if self.part.take().is_some() {
            // If it stays, the next run finds it damaged.
            let _ = std::fs::remove_file(self.cache.part_file(self.digest));
        }
    }
}

fn digest_of(bytes: &[u8]) -> SceneDigest {
    SceneDigest(*blake3::hash(bytes).as_bytes())
}

/// Returns a file's bytes if it has exactly `length`.
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

    fn missing(cache: &SceneCache) -> SceneFetch {
        match cache.look_up(digest_of(SCENE), SCENE.len() as u64).unwrap() {
            CachedScene::Missing(fetch) => fetch,
            CachedScene::Whole(_) => panic!("it is cached"),
        }
    }

    fn is_cached(cache: &SceneCache) -> bool {
        let found = cache.look_up(digest_of(SCENE), SCENE.len() as u64).unwrap();
        matches!(found, CachedScene::Whole(bytes) if bytes == SCENE)
    }

    fn fetch_rest(mut fetch: SceneFetch) -> Option<Vec<u8>> {
        let have = fetch.fetched();
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
    fn an_interrupted_fetch_resumes_where_it_stopped() {
        let folder = tempfile::tempdir().unwrap();
        let cache = SceneCache::new(Some(folder.path().into()));
        let mut fetch = missing(&cache);
        fetch.append(0, &SCENE[..10]).unwrap();
        drop(fetch);
        let fetch = missing(&cache);
        assert_eq!(fetch.fetched(), 10);
        assert_eq!(fetch_rest(fetch).unwrap(), SCENE);
        assert!(is_cached(&cache));
    }

    #[test]
    fn damaged_files_are_fetched_again() {
        let folder = tempfile::tempdir().unwrap();
        let cache = SceneCache::new(Some(folder.path().into()));
        // A damaged scene counts as missing.
        fetch_rest(missing(&cache)).unwrap();
        let file = cache.scene_file(digest_of(SCENE));
        let mut bytes = SCENE.to_vec();
        bytes[3] ^= 1;
        std::fs::write(&file, &bytes).unwrap();
        // So does one of another length.
        let mut fetch = missing(&cache);
        assert_eq!((fetch.fetched(), file.exists()), (0, false));
        // A damaged part is fetched again from its first byte.
        fetch.append(0, &bytes[..20]).unwrap();
        drop(fetch);
        let mut fetch = missing(&cache);
        fetch.append(20, &SCENE[20..]).unwrap();
        assert_eq!(fetch.finish().unwrap(), None);
        assert_eq!(fetch.fetched(), 0);
        assert_eq!(fetch_rest(fetch).unwrap(), SCENE);
        assert!(is_cached(&cache));
    }

    #[test]
    fn a_lying_server_is_detected() {
        let folder = tempfile::tempdir().unwrap();
        let cache = SceneCache::new(Some(folder.path().into()));
        let mut fetch = missing(&cache);
        assert!(matches!(fetch.append(1, b"x"), Err(SceneFetchError::Gap { expected: 0, found: 1 })));
        assert!(matches!(fetch.append(0, &[0; 45]), Err(SceneFetchError::Overrun(44))));
        fetch.append(0, &[7; 44]).unwrap();
        assert!(matches!(fetch.finish(), Err(SceneFetchError::Digest { .. })));
        drop(fetch);
        assert_eq!(missing(&cache).fetched(), 0);
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
        assert_eq!(second.fetched(), 0);
        assert_eq!(fetch_rest(second).unwrap(), SCENE);
        assert!(!is_cached_without_fetching(&cache));
        assert_eq!(fetch_rest(first).unwrap(), SCENE);
        assert!(is_cached(&cache));
    }

    fn is_cached_without_fetching(cache: &SceneCache) -> bool {
        cache.scene_file(digest_of(SCENE)).exists()
    }

    #[test]
    fn scenes_are_fetched_without_a_cache_folder() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("not a folder");
        std::fs::write(&file, b"").unwrap();
        assert_eq!(fetch_rest(missing(&SceneCache::new(Some(file)))).unwrap(), SCENE);
    }
}
