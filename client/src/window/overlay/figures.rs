//! The last ten seconds in figures: what graphs are drawn of, and what a second of them comes to.

use std::{
    collections::VecDeque,
    time::{Duration, Instant},
};

use crate::{
    headless::stats::{FrameStats, millis},
    link::receive::Received,
    mode::State,
};

/// How far back figures go.
pub(crate) const SPAN: Duration = Duration::from_secs(10);

/// Over what rates are taken.
const RATE_SPAN: Duration = Duration::from_secs(1);

/// Most frames that are remembered: 400 a second.
const MOST_FRAMES: usize = 4000;

/// A frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Figure {
    pub(crate) at: Instant,
    /// Time since the frame before, in milliseconds.
    pub(crate) frame_ms: f64,
    /// Frames that its mask is older.
    pub(crate) lag: Option<u32>,
    /// Bits of the mask that came with it; 0 when none came.
    pub(crate) bits: f64,
    mask_frame: Option<u32>,
    received: Received,
}

/// What is shown in words.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Now {
    pub(crate) client_fps: f64,
    pub(crate) visibility_fps: f64,
    pub(crate) lag: Option<u32>,
    pub(crate) response_ms: Option<f64>,
    pub(crate) round_trip_ms: Option<f64>,
    /// Share of the frames that did not come whole.
    pub(crate) loss: Option<f64>,
    pub(crate) megabits_per_s: f64,
    pub(crate) known_share: Option<f64>,
    pub(crate) state: State,
    pub(crate) visibility_share: f32,
}

/// The last ten seconds.
#[derive(Debug, Default)]
pub(crate) struct Figures {
    frames: VecDeque<Figure>,
    latest: Option<FrameStats>,
    response_ms: Option<f64>,
    round_trip: Option<Duration>,
}

impl Figures {
    /// Adds a frame that was drawn at `now`.
    pub(crate) fn push(&mut self, now: Instant, stats: &FrameStats, received: Received, round_trip: Option<Duration>) {
        let before = self.frames.back();
        let frame_ms = before.map_or(0.0, |before| millis(now.saturating_duration_since(before.at)));
        let fresh = stats.mask_frame.is_some() && before.is_some_and(|before| before.mask_frame != stats.mask_frame);
        let bits = if fresh { stats.bytes.unwrap_or(0) as f64 * 8.0 } else { 0.0 };
        let figure = Figure { at: now, frame_ms, lag: stats.lag, bits, mask_frame: stats.mask_frame, received };
        self.frames.push_back(figure);
        while self.frames.len() > MOST_FRAMES
            || self.frames.front().is_some_and(|oldest| now.saturating_duration_since(oldest.at) > SPAN)
        {
            self.frames.pop_front();
        }
        self.response_ms = stats.response_ms.or(self.response_ms);
        self.round_trip = round_trip;
        self.latest = Some(*stats);
    }

    /// The frames, the oldest first.
    pub(crate) fn frames(&self) -> impl ExactSizeIterator<Item = &Figure> {
        self.frames.iter()
    }

    /// What the last second comes to, once there is a frame.
    pub(crate) fn now(&self) -> Option<Now> {
        let (latest, newest) = (self.latest?, self.frames.back()?);
        let recent = |frame: &&Figure| newest.at.saturating_duration_since(frame.at) < RATE_SPAN;
        // A frame that takes a second still has a rate.
        let first = self.frames.iter().find(recent)?;
        let first = if first.at == newest.at { self.frames.iter().rev().nth(1).unwrap_or(first) } else { first };
        let span_s = newest.at.saturating_duration_since(first.at).as_secs_f64();
        let per_s = |count: f64| if span_s > 0.0 { count / span_s } else { 0.0 };
        // The first frame begins the span; what came with it came before.
        let later = || self.frames.iter().rev().take_while(|frame| frame.at > first.at);
        let frames = later().count();
        let more = |of: fn(&Received) -> u64| of(&newest.received).saturating_sub(of(&first.received));
        let whole = more(|received| received.frames) + more(|received| received.cut);
        let lost = more(|received| received.incomplete) + more(|received| received.partial);
        Some(Now {
            client_fps: per_s(frames as f64),
            visibility_fps: per_s(later().filter(|frame| frame.bits > 0.0).count() as f64),
            lag: latest.lag,
            response_ms: self.response_ms,
            round_trip_ms: self.round_trip.map(millis),
            loss: (whole + lost > 0).then(|| lost as f64 / (whole + lost) as f64),
            megabits_per_s: per_s(later().map(|frame| frame.bits).sum::<f64>()) / 1e6,
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
    fn rates_are_those_of_the_last_second_and_memory_those_of_ten() {
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
    fn no_screen_is_so_fast_that_memory_grows() {
        let (mut figures, begun) = (Figures::default(), Instant::now());
        for frame in 0..10_000 {
            figures.push(begun + Duration::from_micros(100) * frame, &stats(frame, frame), Received::default(), None);
        }
        assert_eq!(figures.frames().len(), MOST_FRAMES);
    }
}
