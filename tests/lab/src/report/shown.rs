//! A picture in the client's statistics.

use gnomon_client::mode::State;
use serde::Deserialize;

#[derive(Debug, Clone, PartialEq, Deserialize)]
pub(super) struct Shown {
    /// Time since the first frame, in milliseconds.
    pub(super) t_ms: f64,
    pub(super) state: State,
    /// Age of the mask, in frames.
    pub(super) lag: Option<u32>,
}
