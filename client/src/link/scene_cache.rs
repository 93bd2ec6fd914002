//! A disk cache of packed scenes, keyed by digest.
//!
//! `DIGEST.scene` is used only if its bytes have that digest. A scene being fetched grows in `DIGEST.part`, which one
//! client at a time holds locked. An interrupted fetch resumes where it stopped. A part that was whole when its client
//! ended is used. If the cache cannot be written, clients work without it.

use std::{
    fs::File,
    io::{self, Read as _, Seek as _, SeekFrom, Write as _},
    path::{Path, PathBuf},
    time::SystemTime,
};

use etcetera::BaseStrategy as _;
use gnomon_protocol::{ids::SceneDigest, limits::MAX_SCENE_BYTES};
use thiserror::Error;

use super::cache_folder::{self, Cleared};

#[derive(Debug, Clone)]
pub struct SceneCache {
    /// `None` if no folder belongs to this user alone.
    folder: Option<PathBuf>,
    /// Most bytes of all scenes beside the one in use.
    limit_bytes: u64,
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
    /// Uses `folder`, or the platform's cache directory. Without either nothing is cached: a folder for temporary files
    /// belongs to everybody. Scenes above `limit_bytes` are not cached.
    #[must_use]
    pub fn new(folder: Option<PathBuf>, limit_bytes: u64) -> Self {
        let platform = || Some(etcetera::choose_base_strategy().ok()?.cache_dir().join("gnomon/scenes"));
        Self { folder: folder.or_else(platform), limit_bytes }
    }

    /// Returns where scenes are cached, if anywhere.
    #[must_use]
    pub fn folder(&self) -> Option<&Path> {
        self.folder.as_deref()
    }

    /// Returns the file of a scene that was looked up or fetched before, if it is cached.
    #[must_use]
    pub fn cached_file(&self, digest: SceneDigest) -> Option<PathBuf> {
        self.scene_file(digest).filter(|file| file.is_file())
    }

    /// Removes all scenes, but none that another client is fetching.
    ///
    /// # Errors
    /// Errors if there is no cache, or its folder cannot be read.
    pub fn clear(&self) -> io::Result<Cleared> {
        let folder = self.folder.as_deref().ok_or_else(no_folder)?;
        cache_folder::clear(folder)
            .map_err(|error| io::Error::new(error.kind(), format!("{}: {error}", folder.display())))
    }

    /// Looks up the scene with this digest and length, and removes it if its bytes have another digest.
    ///
    /// # Errors
    /// Errors if `length` exceeds [`MAX_SCENE_BYTES`].
    pub fn look_up(&self, digest: SceneDigest, length: u64) -> Result<CachedScene, SceneFetchError> {
        if length > MAX_SCENE_BYTES {
            return Err(SceneFetchError::TooLarge(length));
        }
        if let Some(file) = self.scene_file(digest) {
            if let Some(bytes) = read_exactly(&file, length) {
                if digest_of(&bytes) == digest {
                    return Ok(CachedScene::Whole(bytes));
                }
                tracing::warn!(file = %file.display(), "a cached scene is damaged: fetching it again");
            }
            // Another length, damaged, or missing.
            let _ = std::fs::remove_file(&file);
        }
        let mut fetch = SceneFetch { cache: self.clone(), digest, length, bytes: Vec::new(), part: None, resumed: 0 };
        match self.open_part(digest, length) {
            Ok((part, bytes)) => (fetch.part, fetch.resumed, fetch.bytes) = (Some(part), bytes.len() as u64, bytes),
            Err(reason) => tracing::debug!(%reason, "fetching the scene without the cache"),
        }
        // Its client ended before it could rename the part. No server is asked for a rest that does not exist.
        if fetch.resumed == length
            && length > 0
            && let Ok(Some(bytes)) = fetch.finish()
        {
            return Ok(CachedScene::Whole(bytes));
        }
        Ok(CachedScene::Missing(fetch))
    }

    /// Opens and locks the part file, and reads it.
    fn open_part(&self, digest: SceneDigest, length: u64) -> io::Result<(File, Vec<u8>)> {
        let (folder, path) = self.folder.as_deref().zip(self.part_file(digest)).ok_or_else(no_folder)?;
        if length > self.limit_bytes {
            return Err(io::Error::other("the scene is larger than the cache"));
        }
        cache_folder::create(folder)?;
        let mut part = cache_folder::open(&path, true)?;
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

    fn scene_file(&self, digest: SceneDigest) -> Option<PathBuf> {
        Some(self.folder.as_ref()?.join(format!("{digest}.scene")))
    }

    fn part_file(&self, digest: SceneDigest) -> Option<PathBuf> {
        Some(self.folder.as_ref()?.join(format!("{digest}.part")))
    }
}

fn no_folder() -> io::Error {
    io::Error::other("no cache folder of this user is known: pass --cache-dir")
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
                tracing::warn!(%error, "cannot cache the scene");
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

    /// Renames the part file, and makes room for it. A rename is atomic, so no client sees half a scene.
    fn store(&mut self) -> io::Result<()> {
        let Some(part) = self.part.take() else { return Ok(()) };
        let files = self.cache.part_file(self.digest).zip(self.cache.scene_file(self.digest));
        let (Some((part_file, scene_file)), Some(folder)) = (files, &self.cache.folder) else { return Ok(()) };
        part.sync_data()?;
        std::fs::rename(part_file, &scene_file)?;
        cache_folder::shrink(folder, self.cache.limit_bytes, &scene_file)
    }

    fn discard_part(&mut self) {
        if let Some((_, file)) = self.part.take().zip(self.cache.part_file(self.digest)) {
            // If it stays, the next run finds it damaged.
            let _ = std::fs::remove_file(file);
        }
    }
}

fn digest_of(bytes: &[u8]) -> SceneDigest {
    SceneDigest(*blake3::hash(bytes).as_bytes())
}

/// Returns a file's bytes if it has exactly `length`, and marks it as used now.
fn read_exactly(file: &Path, length: u64) -> Option<Vec<u8>> {
    let opened = cache_folder::open(file, false).ok()?;
    // A cache that this user may only read stays as old as it is.
    let _ = opened.set_modified(SystemTime::now());
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

    fn cache_in(folder: &Path) -> SceneCache {
        SceneCache::new(Some(folder.to_owned()), 1000)
    }

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
        let cache = cache_in(&folder.path().join("a/b"));
        assert_eq!(fetch_rest(missing(&cache)).unwrap(), SCENE);
        assert!(is_cached(&cache));
        assert_eq!(std::fs::read_dir(cache.folder().unwrap()).unwrap().count(), 1);
    }

    #[test]
    fn an_interrupted_fetch_resumes_where_it_stopped() {
        let folder = tempfile::tempdir().unwrap();
        let cache = cache_in(folder.path());
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
        let cache = cache_in(folder.path());
        // A damaged scene counts as missing.
        fetch_rest(missing(&cache)).unwrap();
        let file = cache.scene_file(digest_of(SCENE)).unwrap();
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
    fn a_whole_part_is_used_and_a_damaged_one_fetched_again() {
        let folder = tempfile::tempdir().unwrap();
        let cache = cache_in(folder.path());
        let part = cache.part_file(digest_of(SCENE)).unwrap();
        std::fs::write(&part, SCENE).unwrap();
        assert!(is_cached(&cache) && is_cached_without_fetching(&cache) && !part.exists());
        std::fs::remove_file(cache.scene_file(digest_of(SCENE)).unwrap()).unwrap();
        let mut damaged = SCENE.to_vec();
        damaged[3] ^= 1;
        std::fs::write(&part, &damaged).unwrap();
        let fetch = missing(&cache);
        assert_eq!(fetch.fetched(), 0, "no server is asked for bytes after the last one");
        assert_eq!(fetch_rest(fetch).unwrap(), SCENE);
        assert!(is_cached(&cache));
        // One that is too long.
        std::fs::remove_file(cache.scene_file(digest_of(SCENE)).unwrap()).unwrap();
        std::fs::write(&part, [SCENE, b"more"].concat()).unwrap();
        assert_eq!(missing(&cache).fetched(), 0);
    }

    #[test]
    fn the_cache_is_bounded_and_keeps_what_is_used() {
        let folder = tempfile::tempdir().unwrap();
        let cache = SceneCache::new(Some(folder.path().into()), 100);
        let fetch = |scene: &[u8]| {
            let found = cache.look_up(digest_of(scene), scene.len() as u64).unwrap();
            let CachedScene::Missing(mut fetch) = found else { return };
            fetch.append(0, scene).unwrap();
            assert_eq!(fetch.finish().unwrap().unwrap(), scene);
        };
        let scenes = [[b'a'; 40], [b'b'; 40], [b'c'; 40]];
        let kept = || scenes.map(|scene| cache.cached_file(digest_of(&scene)).is_some());
        fetch(&scenes[0]);
        fetch(&scenes[1]);
        // Used again, so the other one is older.
        let old = |scene: &[u8], seconds| {
            let file = File::options().write(true).open(cache.scene_file(digest_of(scene)).unwrap()).unwrap();
            file.set_modified(SystemTime::now() - std::time::Duration::from_secs(seconds)).unwrap();
        };
        old(&scenes[0], 100);
        old(&scenes[1], 50);
        fetch(&scenes[0]);
        fetch(&scenes[2]);
        assert_eq!(kept(), [true, false, true]);
        // One that is larger than the whole cache drives nothing out.
        fetch(&[b'd'; 101]);
        assert_eq!(kept(), [true, false, true]);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2);
    }

    #[cfg(unix)]
    #[test]
    fn a_link_in_a_shared_folder_is_not_followed() {
        let folder = tempfile::tempdir().unwrap();
        let cache = cache_in(folder.path());
        let victim = folder.path().join("victim");
        std::fs::write(&victim, b"mine").unwrap();
        std::os::unix::fs::symlink(&victim, cache.part_file(digest_of(SCENE)).unwrap()).unwrap();
        assert_eq!(fetch_rest(missing(&cache)).unwrap(), SCENE);
        assert_eq!(std::fs::read(&victim).unwrap(), b"mine");
    }

    #[test]
    fn a_lying_server_is_detected() {
        let folder = tempfile::tempdir().unwrap();
        let cache = cache_in(folder.path());
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
        let cache = cache_in(folder.path());
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
        cache.scene_file(digest_of(SCENE)).unwrap().exists()
    }

    #[test]
    fn scenes_are_fetched_without_a_cache_folder() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("not a folder");
        std::fs::write(&file, b"").unwrap();
        assert_eq!(fetch_rest(missing(&cache_in(&file))).unwrap(), SCENE);
    }
}
