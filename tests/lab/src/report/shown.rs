//! What a line of the client's statistics says of a picture.

use gnomon_client::mode::State;
use serde::Deserialize;

/// A picture.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub(super) struct Shown {
    /// Since the first frame, in milliseconds.
    pub(super) t_ms: f64,
    pub(super) state: State,
    /// Frames that its mask was older.
    pub(super) lag: Option<u32>,
}
