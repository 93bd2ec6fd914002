//! Measurements of each frame.

use std::time::Duration;

use serde::Serialize;

use super::mode::State;

/// Time that each stage of a frame took on the client's thread.
#[derive(Debug, Clone, Copy, Default)]
pub struct StageTimes {
    /// Encoding and submitting the G-buffer pass.
    pub surfaces: Duration,
    /// Waiting for the frame's own mask.
    pub wait: Duration,
    /// Uploading masks to the adapter.
    pub upload: Duration,
    /// Encoding and submitting the other passes.
    pub shade: Duration,
    /// Waiting for an earlier picture, reading it back and passing it on.
    pub readback: Duration,
}

/// One frame, as a JSON line. Stage times are those of the renderer's thread.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct FrameStats {
    pub frame: u32,
    /// When its pose was taken, counted from the first frame.
    pub t_ms: f64,
    pub state: State,
    /// Connection state: `live`, `draining`, `lost`, `refused`, `fetching` another scene, or `offline` without a
    /// server.
    pub link: &'static str,
    /// Weight of received visibility against the client's own prediction, 0 to 1.
    pub visibility_share: f32,
    /// Share of pixels whose visibility came from a mask (the sky counts), in the latest picture with a known count.
    pub known_share: Option<f64>,
    /// The frame of the mask used; `None` if no mask fits.
    pub mask_frame: Option<u32>,
    /// Age of the mask in frames.
    pub lag: Option<u32>,
    /// Time between the beginnings of the mask's frame and this one.
    pub age_ms: Option<f64>,
    /// Size of the requested mask, guard band included.
    pub mask_width: u16,
    pub mask_height: u16,
    /// How far ahead of the pose the mask was to be traced.
    pub look_ahead_ms: u16,
    /// From sending a pose until its mask was complete, if this frame took a new mask.
    pub response_ms: Option<f64>,
    /// Submitting the G-buffer pass.
    pub surfaces_ms: f64,
    /// Waiting for the frame's own mask (`--wait`).
    pub wait_ms: f64,
    /// Uploading the mask to the adapter.
    pub upload_ms: f64,
    /// Submitting the other passes.
    pub shade_ms: f64,
    /// Waiting for an earlier picture, reading it back and passing it to the writers.
    pub readback_ms: f64,
    /// Size of the mask's frame on the wire, without headers.
    pub bytes: Option<usize>,
    pub packets: Option<u16>,
}

/// Returns the mean; `None` for no values.
#[must_use]
pub fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// Returns the smallest value that at least `share` of the values do not exceed (nearest rank); `None` for no values.
#[must_use]
pub fn percentile(values: &[f64], share: f64) -> Option<f64> {
    let mut sorted = values.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a rank within the length")]
    let rank = (share * sorted.len() as f64).ceil() as usize;
    sorted.get(rank.saturating_sub(1).min(sorted.len().saturating_sub(1))).copied()
}

/// Returns milliseconds, rounded to microseconds.
#[must_use]
pub fn millis(duration: Duration) -> f64 {
    (duration.as_secs_f64() * 1e6).round() / 1e3
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_use_the_nearest_rank() {
        let values: Vec<f64> = (1..=200).rev().map(f64::from).collect();
        assert_eq!(percentile(&values, 0.99), Some(198.0));
        assert_eq!(percentile(&values, 0.5), Some(100.0));
        assert_eq!(percentile(&values, 1.0), Some(200.0));
        assert_eq!(percentile(&values, 0.0), Some(1.0));
        assert_eq!(percentile(&[7.0], 0.99), Some(7.0));
        assert_eq!(percentile(&[], 0.99), None);
        assert_eq!((mean(&[1.0, 2.0, 6.0]), mean(&[])), (Some(3.0), None));
    }
}
