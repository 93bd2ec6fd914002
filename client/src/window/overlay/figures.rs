//! Figures of the last ten seconds: one for each frame for the graphs, and rates over the last second.

use std::{
    collections::VecDeque,
    time::{Duration, Instant},
};

use crate::{
    headless::stats::{FrameStats, millis},
    link::receive::Received,
    mode::State,
};

pub(crate) const SPAN: Duration = Duration::from_secs(10);

/// Time span of the rates.
const RATE_SPAN: Duration = Duration::from_secs(1);

/// Bounds memory: enough for 400 frames a second.
const MAX_FRAMES: usize = 4000;

#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Figure {
    pub(crate) at: Instant,
    /// Time since the previous frame.
    pub(crate) frame_ms: f64,
    /// Age of its mask in frames.
    pub(crate) lag: Option<u32>,
    /// Size of the mask that arrived with it; 0 if none did.
    pub(crate) bits: f64,
    mask_frame: Option<u32>,
    received: Received,
}

/// The figures that the panel shows as text.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Now {
    pub(crate) client_fps: f64,
    pub(crate) visibility_fps: f64,
    pub(crate) lag: Option<u32>,
    pub(crate) response_ms: Option<f64>,
    pub(crate) round_trip_ms: Option<f64>,
    /// Share of frames that did not arrive complete.
    pub(crate) loss: Option<f64>,
    pub(crate) megabits_per_s: f64,
    pub(crate) known_share: Option<f64>,
    pub(crate) state: State,
    pub(crate) visibility_share: f32,
}

#[derive(Debug, Default)]
pub(crate) struct Figures {
    frames: VecDeque<Figure>,
    latest: Option<FrameStats>,
    response_ms: Option<f64>,
    round_trip: Option<Duration>,
}

impl Figures {
    /// Adds a frame drawn at `now`.
    pub(crate) fn push(&mut self, now: Instant, stats: &FrameStats, received: Received, round_trip: Option<Duration>) {
        let before = self.frames.back();
        let frame_ms = before.map_or(0.0, |before| millis(now.saturating_duration_since(before.at)));
        let fresh = stats.mask_frame.is_some() && before.is_some_and(|before| before.mask_frame != stats.mask_frame);
        let bits = if fresh { stats.bytes.unwrap_or(0) as f64 * 8.0 } else { 0.0 };
        let figure = Figure { at: now, frame_ms, lag: stats.lag, bits, mask_frame: stats.mask_frame, received };
        self.frames.push_back(figure);
        while self.frames.len() > MAX_FRAMES
            || self.frames.front().is_some_and(|oldest| now.saturating_duration_since(oldest.at) > SPAN)
        {
            self.frames.pop_front();
        }
        self.response_ms = stats.response_ms.or(self.response_ms);
        self.round_trip = round_trip;
        self.latest = Some(*stats);
    }

    /// Returns the frames, oldest first.
    pub(crate) fn frames(&self) -> impl ExactSizeIterator<Item = &Figure> {
        self.frames.iter()
    }

    /// Returns the figures over the last second; `None` before the first frame.
    pub(crate) fn now(&self) -> Option<Now> {
        let (latest, newest) = (self.latest?, self.frames.back()?);
        let recent = |frame: &&Figure| newest.at.saturating_duration_since(frame.at) < RATE_SPAN;
        // A frame that takes longer than the span still has a rate.
        let first = self.frames.iter().find(recent)?;
        let first = if first.at == newest.at { self.frames.iter().rev().nth(1).unwrap_or(first) } else { first };
        let span_s = newest.at.saturating_duration_since(first.at).as_secs_f64();
        let per_s = |count: f64| if span_s > 0.0 { count / span_s } else { 0.0 };
        // The first frame starts the span, so its own mask arrived before it.
        let in_span = || self.frames.iter().rev().take_while(|frame| frame.at > first.at);
        let frames = in_span().count();
        let increase = |of: fn(&Received) -> u64| of(&newest.received).saturating_sub(of(&first.received));
        let whole = increase(|received| received.frames) + increase(|received| received.cut);
        let lost = increase(|received| received.incomplete) + increase(|received| received.partial);
        Some(Now {
            client_fps: per_s(frames as f64),
            visibility_fps: per_s(in_span().filter(|frame| frame.bits > 0.0).count() as f64),
            lag: latest.lag,
            response_ms: self.response_ms,
            round_trip_ms: self.round_trip.map(millis),
            loss: (whole + lost > 0).then(|| lost as f64 / (whole + lost) as f64),
            megabits_per_s: per_s(in_span().map(|frame| frame.bits).sum::<f64>()) / 1e6,
            known_share: latest.known_share,
            state: latest.state,
            visibility_share: latest.visibility_share,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stats(frame: u32, mask_frame: u32) -> FrameStats {
        FrameStats {
            frame,
            t_ms: 0.0,
            state: State::Concurrent,
            link: "live",
            visibility_share: 1.0,
            known_share: Some(0.9),
            mask_frame: Some(mask_frame),
            lag: Some(frame - mask_frame),
            age_ms: None,
            mask_width: 64,
            mask_height: 36,
            look_ahead_ms: 0,
            response_ms: None,
            surfaces_ms: 0.0,
            wait_ms: 0.0,
            upload_ms: 0.0,
            shade_ms: 0.0,
            readback_ms: 0.0,
            bytes: Some(1000),
            packets: Some(1),
        }
    }

    #[test]
    fn rates_cover_one_second_and_graphs_ten() {
        let (mut figures, begun) = (Figures::default(), Instant::now());
        assert_eq!(figures.now(), None);
        // Fifty frames a second, a mask with every second one, and every tenth frame of those is lost.
        for frame in 0..1000_u32 {
            let at = begun + Duration::from_millis(20) * frame;
            let received = Received {
                frames: u64::from(frame) * 9 / 20,
                incomplete: u64::from(frame) / 20,
                ..Received::default()
            };
            figures.push(at, &stats(frame, frame / 2 * 2), received, Some(Duration::from_millis(7)));
        }
        let now = figures.now().unwrap();
        assert!((now.client_fps - 50.0).abs() < 1e-9, "{now:?}");
        assert!((now.visibility_fps - 25.0).abs() < 1.1, "{now:?}");
        assert!((now.megabits_per_s - 0.2).abs() < 0.01, "{now:?}");
        assert!((now.loss.unwrap() - 0.1).abs() < 0.02, "{now:?}");
        assert_eq!((now.round_trip_ms, now.lag), (Some(7.0), Some(1)));
        assert_eq!(figures.frames().len(), 501);
        assert!((figures.frames().last().unwrap().frame_ms - 20.0).abs() < 1e-9);
    }

    #[test]
    fn memory_is_bounded_at_any_frame_rate() {
        let (mut figures, begun) = (Figures::default(), Instant::now());
        for frame in 0..10_000 {
            figures.push(begun + Duration::from_micros(100) * frame, &stats(frame, frame), Received::default(), None);
        }
        assert_eq!(figures.frames().len(), MAX_FRAMES);
    }
}
