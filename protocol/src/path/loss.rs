//! How many packets are lost, and how many one after the other: measured by the client, told to the server, and
//! believed by it with some inertia.
//!
//! The client tells totals since its session began, so that nothing is missing when what it says is lost: in a packet
//! of its own, with placeholders in the header's fields but sequence number and data size, and three numbers (u32,
//! little-endian): packets that should have come, packets that did not, and runs of these. All three wrap.

use std::time::Duration;

use thiserror::Error;
use web_time::Instant;

use crate::{
    fec::LossModel,
    header::{HEADER_BYTES, HeaderError, PacketHeader},
};

/// How often the client tells.
pub const FEEDBACK_INTERVAL: Duration = Duration::from_millis(100);

/// Bytes of what it tells, header included.
pub const FEEDBACK_BYTES: usize = HEADER_BYTES + TOTALS_BYTES;

const TOTALS_BYTES: usize = 12;

/// A packet is lost when so many later ones have come; until then it may be late.
const WINDOW: u32 = u64::BITS;

/// A sequence number so far ahead is that of another stream.
const LONGEST_GAP: u32 = 4096;

/// What was counted, modulo 2³².
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct LossTotals {
    /// Packets that should have come.
    pub expected: u32,
    /// Of these, packets that did not.
    pub lost: u32,
    /// Runs of packets that did not come one after the other.
    pub runs: u32,
}

/// Counts what is missing in a stream of sequence numbers, which wrap and may come out of order.
#[derive(Debug, Clone, Default)]
pub struct LossMeter {
    /// The newest number, and how many up to it are still watched.
    newest: Option<(u32, u32)>,
    /// Bit k: number newest − k has come.
    came: u64,
    in_run: bool,
    totals: LossTotals,
}

impl LossMeter {
    /// A packet with this sequence number has come.
    pub fn take(&mut self, sequence: u32) {
        let Some((newest, mut watched)) = self.newest else { return self.start(sequence) };
        let ahead = sequence.wrapping_sub(newest);
        match ahead.cast_signed() {
            1.. if ahead > LONGEST_GAP => self.start(sequence),
            1.. => {
                for _ in 0..ahead {
                    if watched == WINDOW {
                        self.judge();
                    } else {
                        watched += 1;
                    }
                    self.came <<= 1;
                }
                self.came |= 1;
                self.newest = Some((sequence, watched));
            }
            behind => {
                if behind.unsigned_abs() < watched {
                    self.came |= 1 << behind.unsigned_abs();
                }
            }
        }
    }

    fn start(&mut self, sequence: u32) {
        (self.newest, self.came, self.in_run) = (Some((sequence, 1)), 1, false);
    }

    /// The oldest number that is watched has had its time.
    fn judge(&mut self) {
        let lost = self.came >> (WINDOW - 1) == 0;
        let totals = &mut self.totals;
        totals.expected = totals.expected.wrapping_add(1);
        totals.lost = totals.lost.wrapping_add(u32::from(lost));
        totals.runs = totals.runs.wrapping_add(u32::from(lost && !self.in_run));
        self.in_run = lost;
    }

    /// What has been counted so far.
    #[must_use]
    pub const fn totals(&self) -> LossTotals {
        self.totals
    }
}

/// Measures lost packets, and reports the totals every [`FEEDBACK_INTERVAL`].
#[derive(Debug, Clone, Default)]
pub struct LossReporter {
    meter: LossMeter,
    reported_at: Option<Instant>,
    next_sequence: u32,
}

impl LossReporter {
    /// Counts a packet that arrived at `now`. Returns the feedback to send, if it is time.
    pub fn packet(&mut self, sequence: u32, now: Instant) -> Option<LossFeedback> {
        self.meter.take(sequence);
        if self.reported_at.is_some_and(|at| now.saturating_duration_since(at) < FEEDBACK_INTERVAL) {
            return None;
        }
        self.reported_at = Some(now);
        let sequence = self.next_sequence;
        self.next_sequence = sequence.wrapping_add(1);
        Some(LossFeedback { sequence, totals: self.meter.totals() })
    }
}

/// What the client tells.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LossFeedback {
    /// Number of the telling, +1 each; wraps.
    pub sequence: u32,
    /// What it has counted.
    pub totals: LossTotals,
}

/// Why bytes are no [`LossFeedback`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum FeedbackError {
    /// They are no packet at all.
    #[error(transparent)]
    Header(#[from] HeaderError),
    /// The data is not three numbers.
    #[error("feedback has {TOTALS_BYTES} bytes of data, not {0}")]
    Length(usize),
    /// The header says that it belongs to a frame.
    #[error("packet {0} is no feedback: its header describes a frame")]
    Frame(u32),
}

impl LossFeedback {
    /// The packet's bytes.
    #[must_use]
    pub fn encode(&self) -> [u8; FEEDBACK_BYTES] {
        let header = PacketHeader {
            sequence: self.sequence,
            frame: None,
            #[expect(clippy::cast_possible_truncation, reason = "12")]
            data_bytes: TOTALS_BYTES as u16,
            frame_packets: None,
            first: false,
            timestamp_ms: None,
        };
        let mut packet = [0; FEEDBACK_BYTES];
        packet[..HEADER_BYTES].copy_from_slice(&header.encode());
        let LossTotals { expected, lost, runs } = self.totals;
        for (place, number) in packet[HEADER_BYTES..].chunks_exact_mut(4).zip([expected, lost, runs]) {
            place.copy_from_slice(&number.to_le_bytes());
        }
        packet
    }

    /// Feedback from its bytes.
    ///
    /// # Errors
    /// When they are no packet, one of a frame, or have other data than three numbers.
    pub fn decode(datagram: &[u8]) -> Result<Self, FeedbackError> {
        let (header, data) = PacketHeader::decode(datagram)?;
        let numbers: [u8; TOTALS_BYTES] = data.try_into().map_err(|_| FeedbackError::Length(data.len()))?;
        let of_frame = header.frame.is_some() || header.frame_packets.is_some() || header.timestamp_ms.is_some();
        if of_frame || header.first {
            return Err(FeedbackError::Frame(header.sequence));
        }
        let [e0, e1, e2, e3, l0, l1, l2, l3, r0, r1, r2, r3] = numbers;
        let [expected, lost, runs] = [[e0, e1, e2, e3], [l0, l1, l2, l3], [r0, r1, r2, r3]].map(u32::from_le_bytes);
        Ok(Self { sequence: header.sequence, totals: LossTotals { expected, lost, runs } })
    }
}

/// What counted so long ago counts half.
const HALF_LIFE: Duration = Duration::from_secs(4);

/// Loss of more than this share begins to be loss, and of less than [`NO_LOSS`] is none any more.
const LOSS: f64 = 0.001;

/// See [`LOSS`].
const NO_LOSS: f64 = 0.0002;

/// Losses that are no mere chance.
const LEAST_LOST: f64 = 1.5;

/// The server's side: what it believes of the channel. `now` may not go back.
#[derive(Debug, Clone, Copy, Default)]
pub struct LossEstimate {
    heard: Option<(LossFeedback, Instant)>,
    expected: f64,
    lost: f64,
    runs: f64,
    /// Whether there is loss.
    lossy: bool,
}

impl LossEstimate {
    /// Hears what the client tells. What is old or cannot be changes nothing.
    pub fn hear(&mut self, now: Instant, feedback: LossFeedback) {
        let Some((before, at)) = self.heard else {
            self.add(feedback.totals, LossTotals::default(), 1.0);
            self.heard = Some((feedback, now));
            return;
        };
        if feedback.sequence.wrapping_sub(before.sequence).cast_signed() <= 0 {
            return;
        }
        let passed = now.saturating_duration_since(at).as_secs_f64() / HALF_LIFE.as_secs_f64();
        self.add(feedback.totals, before.totals, (-passed).exp2());
        self.heard = Some((feedback, now));
    }

    fn add(&mut self, totals: LossTotals, before: LossTotals, fade: f64) {
        let expected = totals.expected.wrapping_sub(before.expected);
        let lost = totals.lost.wrapping_sub(before.lost);
        let runs = totals.runs.wrapping_sub(before.runs);
        if lost > expected || runs > lost || expected > u32::MAX / 2 {
            return;
        }
        self.expected = self.expected.mul_add(fade, expected.into());
        self.lost = self.lost.mul_add(fade, lost.into());
        self.runs = self.runs.mul_add(fade, runs.into());
        let share = self.share();
        self.lossy = if self.lossy { share >= NO_LOSS } else { share > LOSS && self.lost >= LEAST_LOST };
    }

    fn share(&self) -> f64 {
        self.lost / self.expected.max(1.0)
    }

    /// Whether the client tells of losses at all: then it takes frames in part.
    #[must_use]
    pub const fn is_told(&self) -> bool {
        self.heard.is_some()
    }

    /// The channel's losses; none where there are next to none.
    #[must_use]
    pub fn model(&self) -> LossModel {
        if self.lossy {
            LossModel { loss: self.share(), run: self.lost / self.runs.max(f64::MIN_POSITIVE) }
        } else {
            LossModel::default()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn counted(sequences: impl IntoIterator<Item = u32>) -> LossTotals {
        let mut meter = LossMeter::default();
        sequences.into_iter().for_each(|sequence| meter.take(sequence));
        meter.totals()
    }

    #[test]
    fn what_does_not_come_is_counted_with_its_runs() {
        assert_eq!(counted(0..64), LossTotals::default());
        assert_eq!(counted(0..164), LossTotals { expected: 100, lost: 0, runs: 0 });
        let gaps = (0..164).filter(|number| ![10, 11, 12, 40, 150].contains(number));
        assert_eq!(counted(gaps), LossTotals { expected: 100, lost: 4, runs: 2 });
        // Late, twice, and across the wrap.
        let begin = u32::MAX - 50;
        let late = (0..164).filter(|number| *number != 30).flat_map(|number| {
            let more = [(70, 30), (80, 80), (90, 1)].into_iter().filter(move |(at, _)| *at == number);
            std::iter::once(number).chain(more.map(|(_, number)| number))
        });
        let totals = counted(late.map(|number| begin.wrapping_add(number)));
        assert_eq!(totals, LossTotals { expected: 100, lost: 0, runs: 0 });
        // Another stream begins anew.
        assert_eq!(counted((0..164).chain(1_000_000..1_000_164)), LossTotals { expected: 200, lost: 0, runs: 0 });
    }

    #[test]
    fn feedback_comes_back_and_is_nothing_else() {
        let feedback =
            LossFeedback { sequence: 9, totals: LossTotals { expected: 0x0403_0201, lost: 5, runs: u32::MAX } };
        let bytes = feedback.encode();
        assert_eq!(LossFeedback::decode(&bytes), Ok(feedback));
        assert_eq!(bytes[HEADER_BYTES..HEADER_BYTES + 5], [1, 2, 3, 4, 5]);
        let with = |place: usize, byte: u8| {
            let mut bad = bytes;
            bad[place] = byte;
            LossFeedback::decode(&bad).unwrap_err()
        };
        assert_eq!([with(4, 0), with(10, 2), with(10, 1), with(12, 0)], [FeedbackError::Frame(9); 4]);
        let mut longer = [&bytes[..], &[0]].concat();
        longer[8] = 13;
        assert_eq!(LossFeedback::decode(&longer), Err(FeedbackError::Length(13)));
        assert!(matches!(LossFeedback::decode(&bytes[..20]), Err(FeedbackError::Header(_))));
    }

    /// Told ten times a second of 30 packets each.
    fn told(estimate: &mut LossEstimate, begin: Instant, seconds: std::ops::Range<u32>, lost: u32, run: u32) {
        let mut totals = estimate.heard.map(|(feedback, _)| feedback.totals).unwrap_or_default();
        for tenth in seconds.start * 10..seconds.end * 10 {
            totals.expected += 30;
            totals.lost += if tenth % 10 == 0 { lost } else { 0 };
            totals.runs += if tenth % 10 == 0 { lost / run } else { 0 };
            let feedback = LossFeedback { sequence: tenth, totals };
            estimate.hear(begin + Duration::from_millis(100) * tenth, feedback);
        }
    }

    #[test]
    fn loss_is_believed_soon_and_forgotten_late() {
        let (mut estimate, begin) = (LossEstimate::default(), Instant::now());
        assert!(!estimate.is_told());
        told(&mut estimate, begin, 0..5, 0, 1);
        assert!(estimate.is_told());
        assert_eq!(estimate.model(), LossModel::default());
        told(&mut estimate, begin, 5..20, 24, 8);
        let model = estimate.model();
        assert!((model.loss - 0.08).abs() < 0.015 && (model.run - 8.0).abs() < 1e-9, "{model:?}");
        told(&mut estimate, begin, 20..30, 0, 1);
        assert!(estimate.model().loss > 0.005);
        told(&mut estimate, begin, 30..80, 0, 1);
        assert_eq!(estimate.model(), LossModel::default());
        // A loss in a minute is none.
        told(&mut estimate, begin, 80..81, 1, 1);
        assert_eq!(estimate.model(), LossModel::default());
    }

    #[test]
    fn what_cannot_be_and_what_is_old_change_nothing() {
        let (mut estimate, begin) = (LossEstimate::default(), Instant::now());
        told(&mut estimate, begin, 0..10, 3, 1);
        let before = estimate.model();
        assert!(before.loss > 0.0);
        let totals = |expected, lost, runs| LossTotals { expected, lost, runs };
        for (sequence, totals) in [
            (98, totals(9000, 9000, 9000)),
            (100, totals(3001, 3000, 30)),
            (101, totals(3000, 10, 10)),
            (102, totals(0, 0, u32::MAX)),
        ] {
            estimate.hear(begin + Duration::from_secs(10), LossFeedback { sequence, totals });
            assert!((estimate.model().loss - before.loss).abs() < 1e-9, "{sequence}");
        }
    }
}
