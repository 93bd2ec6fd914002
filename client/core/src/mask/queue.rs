//! Passes masks from the receiver to the renderer by swapping buffers; no mask is copied.
//!
//! The receiver decodes into its back buffer, and the renderer reads its front buffers; neither is shared.
//! [`MaskQueue::publish`] swaps the back buffer into the queue, and [`MaskQueue::take`] swaps the queue with the front
//! buffers. A lock around the queue protects only these swaps. The dissertation's client holds its mutex while it
//! copies to the GPU (§3.3), so its receiver waits for the renderer.
//!
//! A complete mask replaces all masks that the renderer has not taken. A partial mask does not: its missing tiles are
//! looked up in earlier masks. The queue holds at most as many masks as the renderer has layers ([`max_layers`]).

use std::collections::VecDeque;

use gnomon_protocol::coverage::max_layers;

use super::received::ReceivedMask;

/// Masks waiting for the renderer, and spare buffers.
#[derive(Debug, Default)]
pub struct MaskQueue {
    /// Masks that the renderer has not taken, oldest first.
    waiting: VecDeque<ReceivedMask>,
    spare: Vec<ReceivedMask>,
    /// True if a frame was lost since the last mask.
    loss: bool,
    /// Why no more masks will arrive.
    ended: Option<String>,
}

impl MaskQueue {
    /// Queues the filled `back` buffer and puts a spare one in its place. Allocates only if there is no spare.
    pub fn publish(&mut self, back: &mut ReceivedMask) {
        let next = self.spare.pop();
        let next = next.unwrap_or_else(|| ReceivedMask::blank(back.mask.shape(), back.received_at));
        let mask = std::mem::replace(back, next);
        if mask.coverage.is_whole() {
            self.spare.extend(self.waiting.drain(..));
        }
        // More tiles of the newest mask's frame replace that mask.
        if self.waiting.back().is_some_and(|newest| newest.frame == mask.frame) {
            self.spare.extend(self.waiting.pop_back());
        }
        if self.waiting.len() >= max_layers(mask.mask.shape()) {
            self.spare.extend(self.waiting.pop_front());
        }
        self.waiting.push_back(mask);
        self.loss = false;
    }

    /// Swaps the waiting masks, oldest first, with `front`. If none wait, returns false and leaves `front` alone.
    pub fn take(&mut self, front: &mut VecDeque<ReceivedMask>) -> bool {
        if self.waiting.is_empty() {
            return false;
        }
        self.spare.extend(front.drain(..));
        std::mem::swap(&mut self.waiting, front);
        true
    }

    /// Notes that a frame arrived only in part and will not be published.
    pub fn report_loss(&mut self) {
        self.loss = true;
    }

    /// Returns whether a frame was lost since the last mask or the last call.
    pub fn take_loss(&mut self) -> bool {
        std::mem::take(&mut self.loss)
    }

    /// Records that no more masks will arrive. The first reason is kept.
    pub fn end(&mut self, reason: String) {
        self.ended.get_or_insert(reason);
    }

    /// Returns why no more masks will arrive, or `None` while they may.
    #[must_use]
    pub fn ended(&self) -> Option<&str> {
        self.ended.as_deref()
    }
}

#[cfg(test)]
#[expect(clippy::disallowed_methods, reason = "tests have a clock")]
mod tests {
    use gnomon_protocol::{ids::FrameNumber, mask::MaskShape};
    use web_time::Instant;

    use super::*;

    struct Ends {
        queue: MaskQueue,
        back: ReceivedMask,
        front: VecDeque<ReceivedMask>,
    }

    impl Ends {
        fn new() -> Self {
            let back = ReceivedMask::blank(MaskShape::new(16, 16, 1).unwrap(), Instant::now());
            Self { queue: MaskQueue::default(), back, front: VecDeque::new() }
        }

        fn publish(&mut self, frame: u32, whole: bool) {
            self.back.frame = FrameNumber(frame);
            let (shape, coverage) = (self.back.mask.shape(), &mut self.back.coverage);
            if whole {
                coverage.set_whole(shape);
            } else {
                coverage.set_none(shape);
            }
            self.queue.publish(&mut self.back);
        }

        fn take(&mut self) -> Option<Vec<u32>> {
            self.queue.take(&mut self.front).then(|| self.front.iter().map(|mask| mask.frame.0).collect())
        }
    }

    #[test]
    fn a_partial_mask_replaces_only_an_earlier_part_of_its_own_frame() {
        let mut ends = Ends::new();
        ends.publish(1, true);
        [2, 2, 3].into_iter().for_each(|frame| ends.publish(frame, false));
        assert_eq!(ends.take().unwrap(), [1, 2, 3]);
        ends.publish(4, false);
        ends.publish(5, true);
        assert_eq!(ends.take().unwrap(), [5]);
        (6..26).for_each(|frame| ends.publish(frame, false));
        assert_eq!(ends.take().unwrap(), (18..26).collect::<Vec<_>>());
        assert_eq!(ends.take(), None);
    }

    #[test]
    fn buffers_are_reused() {
        let mut ends = Ends::new();
        (0..99).for_each(|frame| ends.publish(frame, false));
        ends.take();
        (99..199).for_each(|frame| ends.publish(frame, false));
        assert!(ends.queue.spare.len() <= 2 * max_layers(ends.back.mask.shape()));
    }
}
