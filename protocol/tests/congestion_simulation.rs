//! The delay-based controller on a simulated path: a bottleneck with a queue, a propagation delay and random loss.
//! Deterministic: time is counted in µs, and randomness is seeded.

mod common;

use std::{
    collections::VecDeque,
    time::{Duration, Instant},
};

use gnomon_protocol::{congestion::DelayController, refresh::PathState};

use crate::common::Random;

const DATAGRAM_BYTES: u64 = 1200;
const FRAME_BYTES: u64 = 100_000;
const FRAME_US: u64 = 1_000_000 / 60;
/// Four frames: what the transport's notes ask for.
const WINDOW_BYTES: u64 = 4 * FRAME_BYTES;

/// A path. Time is in µs.
#[derive(Debug, Clone, Copy)]
struct Path {
    bits_per_s: u64,
    round_trip_us: u64,
    /// Capacity of the queue before the bottleneck.
    queue_us: u64,
    loss_per_mille: u64,
    /// Largest random delay of an acknowledgement.
    jitter_us: u64,
}

#[derive(Debug, Clone, Copy)]
enum Source {
    /// As much as the window allows.
    Greedy,
    /// Frames at 60 Hz. Skips those that do not fit a buffer of 1.6 frames.
    Frames,
    /// Frames at 60 Hz, each cut down to its budget.
    Budgeted,
}

#[derive(Debug, Clone, Copy)]
struct InFlight {
    sent_us: u64,
    back_us: u64,
    queued_us: u64,
    lost: bool,
}

struct Sender {
    controller: DelayController,
    source: Source,
    backlog_bytes: u64,
    next_frame_us: u64,
    /// When the waiting frame was made.
    made_us: u64,
    /// True if its last frame was cut.
    held_back: bool,
    next_send_us: u64,
    smoothed_us: Option<u64>,
    in_flight: VecDeque<InFlight>,
    report: Report,
}

/// Measurements after the first quarter of the time.
#[derive(Debug, Default)]
struct Report {
    delivered_bytes: u64,
    tail_drops: u64,
    /// From the very start.
    all_drops: u64,
    queued_us: Vec<u64>,
    /// Time from making a budgeted frame until its last datagram leaves the queue, and its bytes.
    frames: Vec<(u64, u64)>,
    windows: Vec<u64>,
}

impl Report {
    fn queued_ms(&self, per_mille: usize) -> u64 {
        let mut sorted = self.queued_us.clone();
        sorted.sort_unstable();
        sorted[(sorted.len() - 1) * per_mille / 1000] / 1000
    }

    /// Returns the share of the path's rate that arrived over `seconds`, in per cent.
    fn used_percent(&self, path: Path, seconds: u64) -> u64 {
        self.delivered_bytes * 8 * 100 / (path.bits_per_s * seconds)
    }
}

impl Sender {
    fn new(source: Source) -> Self {
        // Frames that are cut start with a smaller window.
        let window_bytes = if matches!(source, Source::Budgeted) { 64 * 1024 } else { WINDOW_BYTES };
        Self {
            controller: DelayController::new(window_bytes, 1200),
            source,
            backlog_bytes: 0,
            next_frame_us: 0,
            made_us: 0,
            held_back: false,
            next_send_us: 0,
            smoothed_us: None,
            in_flight: VecDeque::new(),
            report: Report::default(),
        }
    }

    fn produce(&mut self, now_us: u64) {
        match self.source {
            Source::Greedy => self.backlog_bytes = 1 << 20,
            Source::Frames if now_us >= self.next_frame_us => {
                self.next_frame_us += FRAME_US;
                if self.backlog_bytes + FRAME_BYTES <= FRAME_BYTES * 8 / 5 {
                    self.backlog_bytes += FRAME_BYTES;
                }
            }
            Source::Budgeted if now_us >= self.next_frame_us => {
                self.next_frame_us += FRAME_US;
                let path = PathState {
                    window_bytes: self.controller.window_bytes(),
                    round_trip: Duration::from_micros(self.smoothed_us.unwrap_or(0)),
                    waiting_bytes: self.backlog_bytes,
                };
                let budget = path.frame_budget(Duration::from_micros(FRAME_US)) as u64;
                self.held_back = budget < FRAME_BYTES;
                let bytes = (FRAME_BYTES.min(budget) / DATAGRAM_BYTES).max(1) * DATAGRAM_BYTES;
                if self.backlog_bytes <= (bytes * 3 / 5).max(16 * 1024) {
                    self.made_us = now_us;
                    self.backlog_bytes += bytes;
                    self.report.frames.push((u64::MAX, bytes));
                }
            }
            Source::Frames | Source::Budgeted => {}
        }
    }

    fn may_send(&self, now_us: u64) -> bool {
        let in_flight = self.in_flight.len() as u64 * DATAGRAM_BYTES;
        self.backlog_bytes >= DATAGRAM_BYTES
            && now_us >= self.next_send_us
            && in_flight + DATAGRAM_BYTES <= self.controller.window_bytes()
    }

    /// Quinn's pacing: window over round trip, times 5/4.
    fn pace(&mut self, now_us: u64) {
        self.backlog_bytes -= DATAGRAM_BYTES;
        let round_trip_us = self.smoothed_us.unwrap_or(0);
        let step_us = DATAGRAM_BYTES * round_trip_us * 4 / (5 * self.controller.window_bytes());
        self.next_send_us = self.next_send_us.max(now_us.saturating_sub(2000)) + step_us;
    }

    fn receive(&mut self, start: Instant, now_us: u64, measuring: bool) {
        while let Some(packet) = self.in_flight.front().copied().filter(|packet| packet.back_us <= now_us) {
            self.in_flight.pop_front();
            let now = start + Duration::from_micros(now_us);
            if packet.lost {
                self.controller.on_loss(now, DATAGRAM_BYTES, false);
            } else {
                let sample = now_us - packet.sent_us;
                let smoothed = self.smoothed_us.map_or(sample, |smoothed| (smoothed * 7 + sample) / 8);
                self.smoothed_us = Some(smoothed);
                let limited = self.backlog_bytes < DATAGRAM_BYTES && !self.held_back;
                self.controller.on_ack(now, DATAGRAM_BYTES, limited, Duration::from_micros(sample));
            }
            if measuring {
                self.report.delivered_bytes += if packet.lost { 0 } else { DATAGRAM_BYTES };
                self.report.queued_us.push(packet.queued_us);
                self.report.windows.push(self.controller.window_bytes());
            }
        }
    }
}

/// Runs the senders side by side over one path for `seconds`, in steps of 50 µs; `change` may change the path.
fn run(mut path: Path, sources: &[Source], seconds: u64, change: impl Fn(u64, &mut Path)) -> Vec<Report> {
    let start = Instant::now();
    let mut random = Random(5);
    let mut senders: Vec<_> = sources.iter().map(|source| Sender::new(*source)).collect();
    let mut free_us = 0;
    for now_us in (0..seconds * 1_000_000).step_by(50) {
        change(now_us, &mut path);
        let measuring = now_us >= seconds * 250_000;
        for sender in &mut senders {
            sender.receive(start, now_us, measuring);
            sender.produce(now_us);
        }
        // Senders take turns, so that none is always first.
        while let Some(sender) = {
            senders.rotate_left(1);
            senders.iter_mut().find(|sender| sender.may_send(now_us))
        } {
            sender.pace(now_us);
            let queued_us = free_us.max(now_us) - now_us;
            let dropped = queued_us > path.queue_us;
            if !dropped {
                free_us = free_us.max(now_us) + DATAGRAM_BYTES * 8_000_000 / path.bits_per_s;
            }
            sender.report.tail_drops += u64::from(dropped && measuring);
            sender.report.all_drops += u64::from(dropped);
            if let Some(frame) = sender.report.frames.last_mut().filter(|_| sender.backlog_bytes < DATAGRAM_BYTES) {
                frame.0 = now_us + queued_us - sender.made_us;
            }
            let late_us = random.below(path.jitter_us + 1);
            let back_us = free_us.max(now_us) + path.round_trip_us + late_us;
            let lost = dropped || random.below(1000) < path.loss_per_mille;
            let place = sender.in_flight.partition_point(|packet| packet.back_us <= back_us);
            sender.in_flight.insert(place, InFlight { sent_us: now_us, back_us, queued_us, lost });
        }
    }
    // Rotation has shuffled the senders. All have the same source, so their order does not matter.
    senders.into_iter().map(|sender| sender.report).collect()
}

fn one(path: Path, source: Source, seconds: u64) -> Report {
    run(path, &[source], seconds, |_, _| {}).pop().unwrap_or_default()
}

const WIDE: Path =
    Path { bits_per_s: 500_000_000, round_trip_us: 40_000, queue_us: 100_000, loss_per_mille: 0, jitter_us: 0 };
const NARROW: Path = Path { bits_per_s: 30_000_000, ..WIDE };

/// Random loss below 10 % is not congestion: the window only grows. (Quinn's own controllers collapse at 1 %.)
#[test]
fn a_little_loss_does_not_shrink_the_window() {
    for (loss_per_mille, least_percent) in [(0, 98), (10, 97), (50, 93)] {
        let path = Path { loss_per_mille, ..WIDE };
        let report = one(path, Source::Frames, 20);
        assert!(*report.windows.iter().min().unwrap() >= WINDOW_BYTES);
        let sent_bytes = 60 * 15 * FRAME_BYTES;
        let arrived = report.delivered_bytes * 100 / sent_bytes;
        assert!(arrived >= least_percent, "{loss_per_mille} ‰: {arrived} % of {sent_bytes} bytes arrived");
    }
}

/// Proves that the test above can fail.
#[test]
fn much_loss_shrinks_the_window() {
    let report = one(Path { loss_per_mille: 200, ..WIDE }, Source::Frames, 20);
    assert!(*report.windows.iter().max().unwrap() < WINDOW_BYTES / 2);
}

/// Sources of 49 Mbit/s and more through 30 Mbit/s: the initial window is four times too large.
#[test]
fn a_bottleneck_is_used_and_its_queue_kept_near_the_target() {
    for round_trip_us in [1_000, 5_000, 40_000, 100_000] {
        for loss_per_mille in [0, 10] {
            for source in [Source::Frames, Source::Greedy] {
                let path = Path { round_trip_us, loss_per_mille, ..NARROW };
                let report = one(path, source, 60);
                let used = report.used_percent(path, 45);
                assert!(used >= 96, "{path:?}, {source:?}: {used} % used");
                assert!(report.queued_ms(990) <= 35, "{path:?}, {source:?}: {} ms queued", report.queued_ms(990));
                assert_eq!(report.tail_drops, 0, "{path:?}, {source:?}");
            }
        }
    }
}

/// Frames of 48 Mbit/s, each cut to its budget, through 10 Mbit/s and a queue of 100 ms. Nothing is dropped, the path
/// is used, and 99 % of frames leave the queue within three frame times: a frame alone takes one, and the controller
/// allows a standing queue of 12 ms.
#[test]
fn budgeted_frames_neither_wait_nor_overflow() {
    for (bits_per_s, loss_per_mille) in [(10_000_000, 0), (10_000_000, 10), (20_000_000, 0)] {
        let path = Path { bits_per_s, loss_per_mille, ..NARROW };
        let report = one(path, Source::Budgeted, 60);
        let used = report.used_percent(path, 45);
        let all = &report.frames[report.frames.len() / 4..];
        let mut late: Vec<u64> = all.iter().map(|frame| frame.0).filter(|late| *late < u64::MAX).collect();
        late.sort_unstable();
        let p99 = late[late.len() * 99 / 100];
        let said = format!("{path:?}: {used} % used, {} of 2700 frames, p99 {p99} µs", all.len());
        assert_eq!(report.all_drops, 0, "{said}");
        assert!(used >= 85 && all.len() >= 2600, "{said}");
        assert!(p99 <= 3 * FRAME_US, "{said}");
    }
}

/// A standing queue must not become the base (rule 6), even after two minutes.
#[test]
fn the_queue_does_not_creep_up() {
    for round_trip_us in [1_000, 40_000] {
        let path = Path { round_trip_us, ..NARROW };
        let report = one(path, Source::Greedy, 120);
        assert!(report.queued_ms(990) <= 35, "{} ms queued", report.queued_ms(990));
    }
}

#[test]
fn jitter_does_not_count_as_a_queue() {
    for jitter_us in [10_000, 30_000, 60_000] {
        let path = Path { jitter_us, ..WIDE };
        let report = one(path, Source::Frames, 20);
        assert!(*report.windows.iter().min().unwrap() >= WINDOW_BYTES, "{jitter_us} µs");
        let path = Path { jitter_us, ..NARROW };
        let report = one(path, Source::Greedy, 20);
        let used = report.used_percent(path, 15);
        assert!(used >= 96, "{jitter_us} µs: {used} % used");
        assert!(report.queued_ms(990) <= 35, "{jitter_us} µs: {} ms queued", report.queued_ms(990));
    }
}

#[test]
fn a_longer_route_is_learnt() {
    let longer = |now_us, path: &mut Path| {
        if now_us > 10_000_000 {
            path.round_trip_us = 100_000;
        }
    };
    // Measured after the first 30 s.
    let report = &run(NARROW, &[Source::Greedy], 120, longer)[0];
    let used = report.used_percent(NARROW, 90);
    assert!(used >= 90, "{used} % used");
}

#[test]
fn two_senders_share_a_path() {
    let reports = run(NARROW, &[Source::Greedy; 2], 60, |_, _| {});
    let used: Vec<_> = reports.iter().map(|report| report.used_percent(NARROW, 45)).collect();
    assert!(used.iter().all(|percent| *percent >= 35), "{used:?} %");
    assert!(used.iter().sum::<u64>() >= 96, "{used:?} %");
}
