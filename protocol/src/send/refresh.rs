//! Which parts of a frame are sent when the path does not bear all of it: those that change most of what the client shows, and none
//! never.
//!
//! A frame whose packets stand alone may leave some out: what it lacks the client looks up in the masks before it
//! ([`crate::coverage`]). So a byte budget decides nothing but which tiles are fresh. A client keeps [`max_layers`] masks, so all tiles
//! come round before these are gone: as much of a frame goes to those that were sent longest ago. The rest goes to the largest
//! changes: a part weighs as many bits as differ from what was sent of its tiles last, each as much as its light gives, times the frames
//! since then. So where only dim lights change tiles are sent less often. Where the
//! budget is too small for a round nothing is sent, and budgets add up until it is not: the frames become fewer.
//!
//! A frame that is not sent whole is nobody's reference: neither end keeps it.

use std::{cmp::Reverse, ops::Range, time::Duration};

use crate::{
    codec::part_words,
    coverage::max_layers,
    frame::{Frame, pieces},
    header::HEADER_BYTES,
    mask::{Mask, MaskShape},
};

/// What is known of a path.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct PathState {
    /// Bytes that may be in flight.
    pub window_bytes: u64,
    /// Round trip, queues counted.
    pub round_trip: Duration,
    /// Bytes that wait to be sent.
    pub waiting_bytes: u64,
}

impl PathState {
    /// Bytes that a frame may have on the wire when the next one follows after `interval`: what the window lets through until then, less
    /// what still waits.
    #[must_use]
    pub fn frame_budget(&self, interval: Duration) -> usize {
        let share =
            u128::from(self.window_bytes).saturating_mul(interval.as_micros()) / self.round_trip.as_micros().max(1);
        usize::try_from(share.saturating_sub(self.waiting_bytes.into())).unwrap_or(usize::MAX)
    }
}

/// Weight of a bit of the brightest light.
pub const FULL_WEIGHT: u32 = 256;

/// What is sent of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Choice {
    /// All of it.
    #[default]
    Whole,
    /// Some parts.
    Parts,
    /// Nothing: with so little, tiles would not come round in time.
    Nothing,
}

/// Frames in which all tiles come round, or two more: parts do not begin with the same tiles in each. Where packets are lost, two rounds
/// have to come before the client has forgotten what was there. A client that keeps but two masks, of more than 4.3 million pixels, has
/// whole frames or none.
fn frames_of_round(shape: MaskShape, lossy: bool) -> usize {
    let layers = max_layers(shape);
    if lossy { layers / 2 - 1 } else { layers - 2 }.max(1)
}

/// A part of the frame at hand.
#[derive(Debug, Clone, Copy)]
struct Part {
    /// Where it begins in the body, and its bytes.
    start: usize,
    bytes: usize,
    /// Frames since some of it was sent last.
    age: u32,
    /// How much the client's tiles differ from it, and for how long.
    weight: u64,
    chosen: bool,
}

/// What the client was sent, and when; its memory serves every frame.
#[derive(Debug, Default)]
pub struct Refresh {
    /// Of each light's bits; lights beyond have full weight.
    weights: Vec<u32>,
    /// What was sent of each tile last.
    sent: Option<Mask>,
    /// The frame that each run of tiles was sent in last, by its first tile, and the frame at hand. Only frames that are sent count.
    sent_in: Vec<u32>,
    frame: u32,
    parts: Vec<Part>,
    order: Vec<usize>,
    /// Tiles of the parts that were chosen, unless all were.
    chosen: Vec<Range<usize>>,
    choice: Choice,
}

impl Refresh {
    /// Of a scene whose lights' bits weigh so much, each at most [`FULL_WEIGHT`].
    #[must_use]
    pub fn new(weights: Vec<u32>) -> Self {
        Self { weights, ..Self::default() }
    }

    /// Takes parts out of the frame of a mask until it fits `budget_bytes`, its packets' headers counted. A body that is not sliced
    /// stays as it is, and so does one of which nothing is to be sent. `lossy` says that packets are lost on the way.
    pub fn choose(&mut self, mask: &Mask, body: &mut Vec<u8>, budget_bytes: usize, lossy: bool) -> Choice {
        self.begin(mask.shape());
        let mut start = 0;
        for part in pieces(body, usize::MAX) {
            self.parts.push(Part { start, bytes: part.len(), age: 0, weight: 0, chosen: false });
            start += part.len();
        }
        let wire_bytes = body.len() + self.parts.len() * HEADER_BYTES;
        let sliced = Frame::parse(body).is_ok_and(|frame| frame.head.codec.is_sliced());
        // As much of each frame as makes a round, and the part that goes beyond it.
        let round_bytes = wire_bytes / frames_of_round(mask.shape(), lossy);
        let longest = self.parts.iter().map(|part| part.bytes + HEADER_BYTES).max().unwrap_or(0);
        self.choice = if !sliced || wire_bytes <= budget_bytes {
            Choice::Whole
        } else if budget_bytes < round_bytes + longest {
            Choice::Nothing
        } else {
            self.leave_out(mask, body, (budget_bytes, round_bytes));
            Choice::Parts
        };
        self.choice
    }

    fn leave_out(&mut self, mask: &Mask, body: &mut Vec<u8>, (budget_bytes, round_bytes): (usize, usize)) {
        let mut parts = std::mem::take(&mut self.parts);
        for part in &mut parts {
            (part.age, part.weight) = self.weight(mask, &body[part.start..part.start + part.bytes]);
        }
        self.order.clear();
        self.order.extend(0..parts.len());
        let mut left = budget_bytes;
        // Equal ones in the picture's order.
        self.order.sort_by_key(|index| Reverse((parts[*index].age, parts[*index].weight)));
        for index in &self.order {
            if budget_bytes - left >= round_bytes {
                break;
            }
            left -= parts[*index].bytes + HEADER_BYTES;
            parts[*index].chosen = true;
        }
        self.order.sort_by_key(|index| Reverse(parts[*index].weight));
        for index in &self.order {
            let needed = parts[*index].bytes + HEADER_BYTES;
            if !parts[*index].chosen && needed <= left {
                left -= needed;
                parts[*index].chosen = true;
            }
        }
        let mut end = 0;
        for part in parts.iter().filter(|part| part.chosen) {
            self.chosen.extend(part_words(mask.shape(), &body[part.start..part.start + part.bytes]));
            body.copy_within(part.start..part.start + part.bytes, end);
            end += part.bytes;
        }
        body.truncate(end);
        self.parts = parts;
    }

    fn begin(&mut self, shape: MaskShape) {
        self.parts.clear();
        self.chosen.clear();
        if self.sent.as_ref().is_none_or(|sent| sent.shape() != shape) {
            self.sent = Some(Mask::new(shape));
            self.sent_in.clear();
            // The client has nothing.
            self.sent_in.resize(shape.words(), self.frame.wrapping_sub(u32::MAX / 2));
        }
    }

    /// Age and weight of a part.
    fn weight(&self, mask: &Mask, part: &[u8]) -> (u32, u64) {
        let Some(sent) = &self.sent else { return (u32::MAX, 0) };
        let (mut changed, mut age) = (0, 0);
        for words in part_words(mask.shape(), part) {
            age = self.frame.wrapping_sub(self.sent_in[words.start]).max(age);
            let weight = self.weights.get(words.start / mask.shape().tiles()).copied().unwrap_or(FULL_WEIGHT);
            let bits = mask.words()[words.clone()].iter().zip(&sent.words()[words]);
            changed += bits.map(|(now, then)| u64::from((now ^ then).count_ones())).sum::<u64>() * u64::from(weight);
        }
        (age, changed * (1 + u64::from(age)) + u64::from(age))
    }

    /// The mask's frame has been sent, as it was chosen.
    pub fn sent(&mut self, mask: &Mask) {
        let Some(sent) = self.sent.as_mut().filter(|sent| sent.shape() == mask.shape()) else { return };
        match self.choice {
            Choice::Whole => {
                sent.words_mut().copy_from_slice(mask.words());
                self.sent_in.fill(self.frame);
            }
            Choice::Parts => {
                for words in self.chosen.drain(..) {
                    self.sent_in[words.start] = self.frame;
                    sent.words_mut()[words.clone()].copy_from_slice(&mask.words()[words]);
                }
            }
            Choice::Nothing => return,
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
