//! A scene on its way from the server.

use gnomon_protocol::{ids::SceneDigest, limits::MAX_SCENE_BYTES};
use thiserror::Error;

/// Reserved before the first byte has come: what a server announces is not allocated at once.
const MAX_RESERVED_BYTES: u64 = 64 << 20;

#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum FetchError {
    #[error("the server's scene has {0} bytes: at most {MAX_SCENE_BYTES} are accepted")]
    TooLarge(u64),
    #[error("a part of the scene starts at byte {found}, expected byte {expected}")]
    Gap { expected: u64, found: u64 },
    #[error("the server sent more than the scene's {0} bytes")]
    Overrun(u64),
    #[error("the server announced the scene {digest} and sent {found}")]
    Digest { digest: SceneDigest, found: SceneDigest },
}

#[derive(Debug)]
pub struct SceneFetch {
    digest: SceneDigest,
    length: u64,
    bytes: Vec<u8>,
}

impl SceneFetch {
    /// # Errors
    /// If the scene is too large.
    pub fn begin(digest: SceneDigest, length: u64) -> Result<Self, FetchError> {
        if length > MAX_SCENE_BYTES {
            return Err(FetchError::TooLarge(length));
        }
        let reserved = usize::try_from(length.min(MAX_RESERVED_BYTES)).unwrap_or(0);
        Ok(Self { digest, length, bytes: Vec::with_capacity(reserved) })
    }

    /// # Errors
    /// If the bytes do not follow the last ones, or are too many.
    pub fn append(&mut self, offset: u64, bytes: &[u8]) -> Result<(), FetchError> {
        let have = self.bytes.len() as u64;
        if offset != have {
            return Err(FetchError::Gap { expected: have, found: offset });
        }
        if have + bytes.len() as u64 > self.length {
            return Err(FetchError::Overrun(self.length));
        }
        self.bytes.extend_from_slice(bytes);
        Ok(())
    }

    /// Returns how many bytes have come, and of how many.
    #[must_use]
    pub fn progress(&self) -> (u64, u64) {
        (self.bytes.len() as u64, self.length)
    }

    /// # Errors
    /// If the bytes have another digest.
    pub fn finish(self) -> Result<Vec<u8>, FetchError> {
        let Self { digest, bytes, .. } = self;
        match digest_of(&bytes) {
            found if found == digest => Ok(bytes),
            found => Err(FetchError::Digest { digest, found }),
        }
    }
}

#[must_use]
pub fn digest_of(packed: &[u8]) -> SceneDigest {
    SceneDigest(*blake3::hash(packed).as_bytes())
}
