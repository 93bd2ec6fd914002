//! Why a scene could not be packed or unpacked.

use thiserror::Error;

use crate::CheckError;

/// Version of the format. Others are refused: scenes travel between programs of one release.
pub(super) const VERSION: u32 = 3;

/// Version of a scene in which something moves. One in which everything rests keeps its bytes, and its digest.
pub(super) const MOVING: u32 = 5;

/// Why a scene could not be packed or unpacked.
#[derive(Debug, Error)]
pub enum PackError {
    #[error("{0} bytes that do not start with \"GNOMSCNE\" are no packed scene")]
    Magic(usize),
    #[error("the packed scene has version {0}; this program reads versions {VERSION} and {MOVING}")]
    Version(u32),
    /// Larger than [`limits`](crate::limits) allows.
    #[error("the scene takes {bytes} bytes {what}; at most {limit} are allowed")]
    Size {
        /// `packed` or `before compression`.
        what: &'static str,
        bytes: u64,
        limit: u64,
    },
    /// The bytes contradict themselves.
    #[error("the packed scene is broken: {0}")]
    Broken(String),
    /// The bytes are well formed, but the scene breaks its guarantees.
    #[error("the packed scene is not legal: {0}")]
    Check(#[from] CheckError),
}

pub(super) fn broken(fault: impl Into<String>) -> PackError {
    PackError::Broken(fault.into())
}
