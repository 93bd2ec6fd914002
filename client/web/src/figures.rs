//! What the page shows beside the picture.

use gnomon_client_core::frame::stats::{FrameStats, mean};
use gnomon_protocol::receive::ReceiverCounters;
use serde::Serialize;

/// Figures of the frames since the last ones were taken.
#[derive(Debug, Default)]
pub struct Figures {
    frames: u32,
    since_s: f64,
    lags: Vec<f64>,
    ages_ms: Vec<f64>,
    last: Option<FrameStats>,
    bytes_before: u64,
}

#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Shown {
    pub frames_per_s: f64,
    pub lag_frames: Option<f64>,
    pub age_ms: Option<f64>,
    pub mbit_per_s: f64,
    pub known_share: Option<f64>,
    pub visibility_share: f32,
    pub state: String,
    pub size: [u32; 2],
    pub frames: u32,
    pub masks: u64,
    pub masks_in_part: u64,
    pub masks_bad: u64,
}

impl Figures {
    pub fn push(&mut self, stats: &FrameStats) {
        self.frames += 1;
        self.lags.extend(stats.lag.map(f64::from));
        self.ages_ms.extend(stats.age_ms);
        self.last = Some(*stats);
    }

    /// Returns the figures at `now_s`, and begins anew. `None` before the first frame.
    pub fn take(&mut self, now_s: f64, received: ReceiverCounters, size: (u32, u32)) -> Option<Shown> {
        let last = self.last?;
        let step_s = (now_s - self.since_s).max(1e-3);
        // A new connection counts from 0.
        let bytes = received.payload_bytes.saturating_sub(self.bytes_before);
        let shown = Shown {
            frames_per_s: f64::from(self.frames) / step_s,
            lag_frames: mean(&self.lags),
            age_ms: mean(&self.ages_ms),
            mbit_per_s: bytes as f64 * 8e-6 / step_s,
            known_share: last.known_share,
            visibility_share: last.visibility_share,
            state: serde_json::to_value(last.state)
                .ok()
                .and_then(|name| name.as_str().map(str::to_owned))
                .unwrap_or_default(),
            size: [size.0, size.1],
            frames: last.frame + 1,
            masks: received.frames + received.cut,
            masks_in_part: received.partial,
            masks_bad: received.bad,
        };
        *self = Self { since_s: now_s, bytes_before: received.payload_bytes, last: self.last, ..Self::default() };
        Some(shown)
    }
}
