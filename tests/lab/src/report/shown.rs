//! A picture in the client's statistics.

use gnomon_client::mode::State;
use serde::Deserialize;

#[derive(Debug, Clone, PartialEq, Deserialize)]
pub(super) struct Shown {
    /// Since the first frame.
    pub(super) t_ms: f64,
    pub(super) state: State,
    /// In frames.
    pub(super) lag: Option<u32>,
}
