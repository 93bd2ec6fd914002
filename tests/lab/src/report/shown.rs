//! A picture, as the client's statistics describe it.

use gnomon_client::mode::State;
use serde::Deserialize;

#[derive(Debug, Clone, PartialEq, Deserialize)]
pub(super) struct Shown {
    /// Time since the first frame, in milliseconds.
    pub(super) t_ms: f64,
    pub(super) state: State,
    /// Age of its mask, in frames.
    pub(super) lag: Option<u32>,
}
