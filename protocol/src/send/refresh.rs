//! Which parts of a frame to send when the path cannot carry all of it.
//!
//! A client looks up missing tiles in earlier masks ([`crate::coverage`]), so a byte budget only decides which tiles
//! are fresh. It keeps [`max_layers`] masks, so every tile must be refreshed before these are gone: a share of each
//! frame goes to the parts that were sent longest ago. The rest goes to the parts with the greatest weight: the number
//! of bits that changed since they were last sent, each times its light's brightness, times the part's age in frames.
//! So tiles that only dim lights change are sent less often. A budget too small for the first share sends nothing;
//! budgets then add up, and fewer frames are sent.
//!
//! Neither end keeps a frame that was not sent whole as a reference.

use std::{cmp::Reverse, ops::Range, time::Duration};

use crate::{
    codec::{EncodedFrame, Part, part_words},
    coverage::max_layers,
    header::HEADER_BYTES,
    mask::{Mask, MaskShape},
};

/// State of the network path.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct PathState {
    /// Bytes that may be in flight.
    pub window_bytes: u64,
    /// Includes queueing.
    pub round_trip: Duration,
    pub waiting_bytes: u64,
}

impl PathState {
    /// Returns the bytes on the wire that a frame may take if the next one follows after `interval`: what the window
    /// lets through until then, minus the bytes that are waiting.
    #[must_use]
    pub fn frame_budget(&self, interval: Duration) -> usize {
        let share =
            u128::from(self.window_bytes).saturating_mul(interval.as_micros()) / self.round_trip.as_micros().max(1);
        usize::try_from(share.saturating_sub(self.waiting_bytes.into())).unwrap_or(usize::MAX)
    }
}

/// Weight of a bit of the brightest light.
pub const FULL_WEIGHT: u32 = 256;

/// How much of a frame is sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Selection {
    #[default]
    Whole,
    Parts,
    /// The budget is too small to refresh every tile in time.
    Nothing,
}

/// Frames within which every tile is refreshed: two fewer than the client keeps, because parts do not begin with the
/// same tiles in each frame. If packets are lost, two refreshes must fit. A client that keeps only two masks (more than
/// 4.3 million pixels) gets whole frames or none.
fn refresh_frames(shape: MaskShape, lossy: bool) -> usize {
    let layers = max_layers(shape);
    if lossy { layers / 2 - 1 } else { layers - 2 }.max(1)
}

/// A part of the frame, as a candidate.
#[derive(Debug, Clone, Copy)]
struct Candidate {
    wire_bytes: usize,
    /// Frames since any of its tiles was sent.
    age: u32,
    weight: u64,
    selected: bool,
}

/// Selects the parts to send; reuses its memory from frame to frame.
#[derive(Debug, Default)]
pub struct Refresh {
    /// Weight of each light's bits; [`FULL_WEIGHT`] for lights beyond the list.
    weights: Vec<u32>,
    /// Each tile's bits as last sent.
    sent: Option<Mask>,
    /// For each block, at its first tile, the frame it was last sent in; and the current frame. Only sent frames count.
    sent_in: Vec<u32>,
    frame: u32,
    candidates: Vec<Candidate>,
    order: Vec<usize>,
    /// Tiles of the selected parts, unless all were selected.
    selected: Vec<Range<usize>>,
    selection: Selection,
}

impl Refresh {
    /// Returns a selector with these weights of the lights' bits, each at most [`FULL_WEIGHT`].
    #[must_use]
    pub fn new(weights: Vec<u32>) -> Self {
        Self { weights, ..Self::default() }
    }

    /// Removes parts from a mask's frame until it fits `budget_bytes`, packet headers included. Leaves the frame
    /// unchanged if it is not sliced or nothing is to be sent. `lossy`: the path loses packets.
    pub fn select(&mut self, mask: &Mask, frame: &mut EncodedFrame, budget_bytes: usize, lossy: bool) -> Selection {
        self.begin(mask.shape());
        let wire_bytes = frame.body().len() + frame.parts().len() * HEADER_BYTES;
        // The share of each frame that refreshes every tile in time.
        let refresh_bytes = wire_bytes / refresh_frames(mask.shape(), lossy);
        let longest = frame.parts().iter().map(|part| part.bytes + HEADER_BYTES).max().unwrap_or(0);
        self.selection = if frame.parts().is_empty() || wire_bytes <= budget_bytes {
            Selection::Whole
        } else if budget_bytes < refresh_bytes + longest {
            Selection::Nothing
        } else {
            self.select_parts(mask, frame, budget_bytes, refresh_bytes);
            Selection::Parts
        };
        self.selection
    }

    fn select_parts(&mut self, mask: &Mask, frame: &mut EncodedFrame, budget_bytes: usize, refresh_bytes: usize) {
        let mut candidates = std::mem::take(&mut self.candidates);
        candidates.clear();
        candidates.extend(frame.parts().iter().map(|part| self.candidate(mask, part)));
        self.order.clear();
        self.order.extend(0..candidates.len());
        let mut left = budget_bytes;
        // Stable, so equal candidates stay in picture order.
        self.order.sort_by_key(|index| Reverse((candidates[*index].age, candidates[*index].weight)));
        for index in &self.order {
            if budget_bytes - left >= refresh_bytes {
                break;
            }
            left -= candidates[*index].wire_bytes;
            candidates[*index].selected = true;
        }
        self.order.sort_by_key(|index| Reverse(candidates[*index].weight));
        for index in &self.order {
            let candidate = &mut candidates[*index];
            if !candidate.selected && candidate.wire_bytes <= left {
                left -= candidate.wire_bytes;
                candidate.selected = true;
            }
        }
        frame.retain_parts(|index, part| {
            let selected = candidates[index].selected;
            if selected {
                self.selected.extend(part_words(mask.shape(), part));
            }
            selected
        });
        self.candidates = candidates;
    }

    fn begin(&mut self, shape: MaskShape) {
        self.selected.clear();
        if self.sent.as_ref().is_none_or(|sent| sent.shape() != shape) {
            self.sent = Some(Mask::new(shape));
            self.sent_in.clear();
            // The client has nothing.
            self.sent_in.resize(shape.words(), self.frame.wrapping_sub(u32::MAX / 2));
        }
    }

    fn candidate(&self, mask: &Mask, part: &Part) -> Candidate {
        let (mut changed, mut age) = (0, 0);
        let words = part_words(mask.shape(), part);
        for (words, sent) in words.filter_map(|words| Some((words.clone(), &self.sent.as_ref()?.words()[words]))) {
            age = self.frame.wrapping_sub(self.sent_in[words.start]).max(age);
            let weight = self.weights.get(words.start / mask.shape().tiles()).copied().unwrap_or(FULL_WEIGHT);
            let bits = mask.words()[words].iter().zip(sent);
            changed += bits.map(|(now, then)| u64::from((now ^ then).count_ones())).sum::<u64>() * u64::from(weight);
        }
        let weight = changed * (1 + u64::from(age)) + u64::from(age);
        Candidate { wire_bytes: part.bytes + HEADER_BYTES, age, weight, selected: false }
    }

    /// Records that the mask's frame was sent as selected.
    pub fn sent(&mut self, mask: &Mask) {
        let Some(sent) = self.sent.as_mut().filter(|sent| sent.shape() == mask.shape()) else { return };
        match self.selection {
            Selection::Whole => {
                sent.words_mut().copy_from_slice(mask.words());
                self.sent_in.fill(self.frame);
            }
            Selection::Parts => {
                for words in self.selected.drain(..) {
                    self.sent_in[words.start] = self.frame;
                    sent.words_mut()[words.clone()].copy_from_slice(&mask.words()[words]);
                }
            }
            Selection::Nothing => return,
        }
        self.frame = self.frame.wrapping_add(1);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frames_budget_is_its_share_of_the_window() {
        let ms = Duration::from_millis;
        let path = PathState { window_bytes: 60_000, round_trip: ms(40), ..PathState::default() };
        assert_eq!(path.frame_budget(ms(20)), 30_000);
        assert_eq!(PathState { waiting_bytes: 12_000, ..path }.frame_budget(ms(20)), 18_000);
        assert_eq!(PathState { waiting_bytes: 90_000, ..path }.frame_budget(ms(20)), 0);
        assert_eq!(PathState { round_trip: Duration::ZERO, ..path }.frame_budget(ms(20)), 1_200_000_000);
        assert_eq!(PathState { window_bytes: u64::MAX, ..path }.frame_budget(Duration::MAX), usize::MAX);
    }
}
