//! What a frame measures.

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
    /// Waiting for an earlier picture, reading it back and handing it on.
    pub readback: Duration,
}

/// One frame, as a JSON line. Times are in milliseconds of the renderer's thread.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct FrameStats {
    /// The frame's number.
    pub frame: u32,
    /// When its pose was taken, since the first frame's.
    pub t_ms: f64,
    /// What the client was doing: `sequential`, `concurrent` or `degraded`.
    pub state: State,
    /// How it stood with the server: `live`, `draining`, `lost` or `refused`; `offline` without one.
    pub link: &'static str,
    /// How much received visibility counted, 0 to 1, against what the client knows by itself.
    pub visibility_share: f32,
    /// Share of a picture's pixels whose visibility a mask said something of (the sky counts); of the latest picture
    /// whose count had come back from the adapter.
    pub known_share: Option<f64>,
    /// The frame whose mask it was shaded with; none while there was no mask that fits.
    pub mask_frame: Option<u32>,
    /// Frames that the mask is older than the picture.
    pub lag: Option<u32>,
    /// Width of the mask that this frame asked for, guard band included.
    pub mask_width: u16,
    /// Its height.
    pub mask_height: u16,
    /// How far ahead the mask was asked to be traced for.
    pub look_ahead_ms: u16,
    /// From a pose's departure until the mask for it was whole, where this frame took a new mask.
    pub response_ms: Option<f64>,
    /// Handing over the G-buffer pass.
    pub surfaces_ms: f64,
    /// Waiting for the frame's own mask (`--wait`).
    pub wait_ms: f64,
    /// Sending the mask to the adapter.
    pub upload_ms: f64,
    /// Handing over the other passes.
    pub shade_ms: f64,
    /// Waiting for an earlier picture, reading it back, and handing it to the writers.
    pub readback_ms: f64,
    /// Bytes that the mask's frame had on the wire, headers not counted.
    pub bytes: Option<usize>,
    /// Packets that it came in.
    pub packets: Option<u16>,
}

/// The mean, if there is any value.
#[must_use]
pub fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// The smallest value that at least `share` of the values do not exceed (nearest rank), if there is any value.
#[must_use]
pub fn percentile(values: &[f64], share: f64) -> Option<f64> {
    let mut sorted = values.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a rank within the length")]
    let rank = (share * sorted.len() as f64).ceil() as usize;
    sorted.get(rank.saturating_sub(1).min(sorted.len().saturating_sub(1))).copied()
}

/// Milliseconds, with microseconds behind the point.
#[must_use]
pub fn millis(duration: Duration) -> f64 {
    (duration.as_secs_f64() * 1e6).round() / 1e3
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_of_the_nearest_rank() {
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
