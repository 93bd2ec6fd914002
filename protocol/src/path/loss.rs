//! Packet loss: how many packets are lost, and how many in a row. The client measures it, and the server smooths it.
//!
//! The client reports totals since its session began, so that a lost report costs nothing. A report is a packet of its
//! own: the header's fields except sequence number and data size are placeholders, and three numbers follow (u32,
//! little-endian): packets expected, packets lost, and runs of lost packets. All three wrap.

use std::time::Duration;

use thiserror::Error;
use web_time::Instant;

use crate::{
    fec::LossModel,
    header::{HEADER_BYTES, HeaderError, PacketHeader},
};

/// How often the client reports.
pub const FEEDBACK_INTERVAL: Duration = Duration::from_millis(100);

/// Bytes of a report, header included.
pub const FEEDBACK_BYTES: usize = HEADER_BYTES + TOTALS_BYTES;

const TOTALS_BYTES: usize = 12;

/// A packet counts as lost once this many later ones have arrived; until then it may be late.
const WINDOW: u32 = u64::BITS;

/// A larger jump in sequence numbers means another stream.
const LONGEST_GAP: u32 = 4096;

/// Totals, modulo 2³².
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct LossTotals {
    pub expected: u32,
    /// Expected packets that did not arrive.
    pub lost: u32,
    /// Runs of consecutive lost packets.
    pub runs: u32,
}

/// Counts what is missing in a stream of sequence numbers, which wrap and may be reordered.
#[derive(Debug, Clone, Default)]
pub struct LossMeter {
    /// The newest number, and how many numbers up to it are still watched.
    newest: Option<(u32, u32)>,
    /// Bit k: number newest − k has arrived.
    came: u64,
    in_run: bool,
    totals: LossTotals,
}

impl LossMeter {
    /// Records that a packet arrived.
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

    /// Counts the oldest watched number as arrived or lost.
    fn judge(&mut self) {
        let lost = self.came >> (WINDOW - 1) == 0;
        let totals = &mut self.totals;
        totals.expected = totals.expected.wrapping_add(1);
        totals.lost = totals.lost.wrapping_add(u32::from(lost));
        totals.runs = totals.runs.wrapping_add(u32::from(lost && !self.in_run));
        self.in_run = lost;
    }

    /// Returns the totals so far.
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

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LossFeedback {
    /// Number of the report, +1 each; wraps.
    pub sequence: u32,
    pub totals: LossTotals,
}

/// Why bytes are not a [`LossFeedback`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum FeedbackError {
    #[error(transparent)]
    Header(#[from] HeaderError),
    #[error("feedback has {TOTALS_BYTES} bytes of data, not {0}")]
    Length(usize),
    #[error("packet {0} is not feedback: its header describes a frame")]
    Frame(u32),
}

impl LossFeedback {
    /// Encodes the report.
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

    /// Decodes a report.
    ///
    /// # Errors
    /// Errors if the bytes are no packet, describe a frame, or do not carry exactly three numbers.
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

/// Age at which a measurement counts half.
const HALF_LIFE: Duration = Duration::from_secs(4);

/// Loss starts to count above this share, and stops below [`NO_LOSS`].
const LOSS: f64 = 0.001;

/// See [`LOSS`].
const NO_LOSS: f64 = 0.0002;

/// Fewer lost packets may be chance.
const LEAST_LOST: f64 = 1.5;

/// The server's estimate of the channel. `now` must not go back.
#[derive(Debug, Clone, Copy, Default)]
pub struct LossEstimate {
    heard: Option<(LossFeedback, Instant)>,
    expected: f64,
    lost: f64,
    runs: f64,
    lossy: bool,
}

impl LossEstimate {
    /// Takes the client's report. Old or impossible reports change nothing.
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

    /// Returns whether the client reports losses at all, which means that it takes partial frames.
    #[must_use]
    pub const fn is_told(&self) -> bool {
        self.heard.is_some()
    }

    /// Returns the channel's loss; zero when negligible.
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
    fn lost_packets_and_their_runs_are_counted() {
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
    fn feedback_round_trips_and_nothing_else_decodes() {
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

    /// Reports ten times a second, of 30 packets each.
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
    fn loss_is_noticed_soon_and_forgotten_late() {
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
        // One loss in a minute counts as none.
        told(&mut estimate, begin, 80..81, 1, 1);
        assert_eq!(estimate.model(), LossModel::default());
    }

    #[test]
    fn impossible_and_old_reports_change_nothing() {
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
