//! The buffer between the receive task and the renderer.
//!
//! The receive task decodes into its back buffer, and the renderer reads its front buffers; neither is shared. When a mask is
//! there, the back buffer changes places with one in the middle, and the renderer takes what is in the middle when it wants newer
//! masks. These swaps, of pointers, are all that is ever done under the lock: the dissertation's client holds its mutex while it
//! copies to the GPU (§3.3), so its receiver waits for the renderer.
//!
//! A whole mask replaces those before it that the renderer has not taken. A mask of which parts are missing does not: what it lacks is
//! looked up in them. As many wait as the renderer looks things up in ([`max_layers`]).

use std::{
    collections::VecDeque,
    sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError},
};

use gnomon_protocol::{
    coverage::{Coverage, max_layers},
    ids::FrameNumber,
    mask::{Mask, MaskShape},
    pose::Pose,
};
use web_time::Instant;

/// A mask and where it came from.
#[derive(Debug, Clone)]
pub struct ReceivedMask {
    /// The frame whose pose it was traced for.
    pub frame: FrameNumber,
    /// The mask.
    pub mask: Mask,
    /// What of it has come.
    pub coverage: Coverage,
    /// The pose that it was traced for, where the server has looked ahead; that of its frame without.
    pub traced_for: Option<Pose>,
    /// Bytes that the encoded frame had, packet headers not counted.
    pub payload_bytes: usize,
    /// Packets that it came in.
    pub packets: u16,
    /// When its last packet had come.
    pub received_at: Instant,
}

#[derive(Debug)]
struct Middle {
    /// Masks that the renderer has not seen, in the order of their coming.
    fresh: VecDeque<ReceivedMask>,
    /// Memory for those to come.
    spare: Vec<ReceivedMask>,
    /// Whether a frame was lost since the last mask.
    lost: bool,
    /// Why no more masks will come.
    ended: Option<String>,
}

impl Middle {
    /// Takes another mask in.
    fn push(&mut self, mask: ReceivedMask) {
        if mask.coverage.is_whole() {
            self.spare.extend(self.fresh.drain(..));
        }
        // More of the newest mask stands in its place.
        if self.fresh.back().is_some_and(|newest| newest.frame == mask.frame) {
            self.spare.extend(self.fresh.pop_back());
        }
        if self.fresh.len() >= max_layers(mask.mask.shape()) {
            self.spare.extend(self.fresh.pop_front());
        }
        self.fresh.push_back(mask);
    }
}

#[derive(Debug)]
struct Shared {
    shape: MaskShape,
    middle: Mutex<Middle>,
    changed: Condvar,
}

impl Shared {
    /// A panic while pointers are swapped cannot leave them half swapped.
    fn lock(&self) -> MutexGuard<'_, Middle> {
        self.middle.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The receive task's end.
#[derive(Debug)]
pub struct MaskWriter {
    shared: Arc<Shared>,
    back: ReceivedMask,
}

/// The renderer's end.
#[derive(Debug)]
pub struct MaskReader {
    shared: Arc<Shared>,
    /// Masks that were taken last, in the order of their coming.
    front: VecDeque<ReceivedMask>,
}

/// How waiting for a mask ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Waited {
    /// The mask is in the front buffer.
    Arrived,
    /// It did not come in time.
    TimedOut,
    /// A frame has come in part since the last mask: who waits for one waits in vain.
    Lost,
    /// No more masks will come, and why.
    Ended(String),
}

/// A buffer for masks of `shape`.
#[must_use]
pub fn mask_buffer(shape: MaskShape) -> (MaskWriter, MaskReader) {
    let middle = Middle { fresh: VecDeque::new(), spare: Vec::new(), lost: false, ended: None };
    let shared = Arc::new(Shared { shape, middle: Mutex::new(middle), changed: Condvar::new() });
    let reader = MaskReader { shared: Arc::clone(&shared), front: VecDeque::new() };
    (MaskWriter { shared, back: blank(shape) }, reader)
}

fn blank(shape: MaskShape) -> ReceivedMask {
    ReceivedMask {
        frame: FrameNumber(0),
        mask: Mask::new(shape),
        coverage: Coverage::whole(shape),
        traced_for: None,
        payload_bytes: 0,
        packets: 0,
        received_at: Instant::now(),
    }
}

impl MaskWriter {
    /// The back buffer, to fill.
    pub fn back(&mut self) -> &mut ReceivedMask {
        &mut self.back
    }

    /// Hands the back buffer over. Whole masks replace those that the renderer has not taken yet.
    pub fn publish(&mut self) {
        let mut middle = self.shared.lock();
        // Memory is made when the buffers are fewer than the masks that wait, and then serves for ever.
        let next = middle.spare.pop().unwrap_or_else(|| blank(self.shared.shape));
        middle.push(std::mem::replace(&mut self.back, next));
        middle.lost = false;
        drop(middle);
        self.shared.changed.notify_all();
    }

    /// Says that a frame came in part only.
    pub fn lose(&self) {
        self.shared.lock().lost = true;
        self.shared.changed.notify_all();
    }

    /// Says that no more masks will come. The first reason counts.
    pub fn end(&self, reason: String) {
        self.ender().end(reason);
    }

    /// Somebody else who may say so.
    #[must_use]
    pub fn ender(&self) -> MaskEnder {
        MaskEnder { shared: Arc::clone(&self.shared) }
    }
}

/// Tells the renderer that no more masks will come.
#[derive(Debug, Clone)]
pub struct MaskEnder {
    shared: Arc<Shared>,
}

impl MaskEnder {
    /// Says so. The first reason counts.
    pub fn end(&self, reason: String) {
        self.shared.lock().ended.get_or_insert(reason);
        self.shared.changed.notify_all();
    }
}

impl Drop for MaskWriter {
    fn drop(&mut self) {
        self.end("the receive task has stopped".to_owned());
    }
}

impl MaskReader {
    /// The newest mask there is, and whether it is another one than last time.
    pub fn newest(&mut self) -> Option<(&ReceivedMask, bool)> {
        let shared = Arc::clone(&self.shared);
        let changed = self.take(&mut shared.lock());
        self.front().map(|front| (front, changed))
    }

    /// The newest of the masks that were taken last.
    #[must_use]
    pub fn front(&self) -> Option<&ReceivedMask> {
        self.front.back()
    }

    /// All masks that were taken last, in the order of their coming: what the later ones lack may be in the earlier ones.
    pub fn taken(&self) -> impl Iterator<Item = &ReceivedMask> {
        self.front.iter()
    }

    /// Waits for the mask of exactly this frame, but not beyond `deadline`. Others that come are passed over.
    pub fn wait_for(&mut self, frame: FrameNumber, deadline: Instant) -> Waited {
        self.wait_until(deadline, true, |front, _| front.frame == frame)
    }

    /// Waits for a mask that has not been in the front buffer yet, but not beyond `deadline`. Losses do not end it.
    pub fn wait_for_any(&mut self, deadline: Instant) -> Waited {
        self.wait_until(deadline, false, |_, fresh| fresh)
    }

    fn wait_until(
        &mut self,
        deadline: Instant,
        heed_losses: bool,
        is_it: impl Fn(&ReceivedMask, bool) -> bool,
    ) -> Waited {
        let shared = Arc::clone(&self.shared);
        let mut middle = shared.lock();
        loop {
            let fresh = self.take(&mut middle);
            if self.front().is_some_and(|front| is_it(front, fresh)) {
                return Waited::Arrived;
            }
            if let Some(reason) = &middle.ended {
                return Waited::Ended(reason.clone());
            }
            if std::mem::take(&mut middle.lost) && heed_losses {
                return Waited::Lost;
            }
            let now = Instant::now();
            if now >= deadline {
                return Waited::TimedOut;
            }
            (middle, _) = shared.changed.wait_timeout(middle, deadline - now).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Why no more masks will come, if that is so.
    #[must_use]
    pub fn ended(&self) -> Option<String> {
        self.shared.lock().ended.clone()
    }

    fn take(&mut self, middle: &mut Middle) -> bool {
        if middle.fresh.is_empty() {
            return false;
        }
        middle.spare.extend(self.front.drain(..));
        std::mem::swap(&mut middle.fresh, &mut self.front);
        true
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    fn shape() -> MaskShape {
        MaskShape::new(16, 16, 1).unwrap()
    }

    fn fill(writer: &mut MaskWriter, frame: u32) {
        let back = writer.back();
        back.frame = FrameNumber(frame);
        back.mask.words_mut().fill(u64::from(frame));
        back.coverage.set_whole(back.mask.shape());
        writer.publish();
    }

    fn fill_in_part(writer: &mut MaskWriter, frame: u32) {
        let back = writer.back();
        back.frame = FrameNumber(frame);
        back.coverage.set_none(back.mask.shape());
        writer.publish();
    }

    #[test]
    fn the_renderer_sees_the_newest_whole_mask() {
        let (mut writer, mut reader) = mask_buffer(shape());
        assert!(reader.newest().is_none() && reader.front().is_none());
        fill(&mut writer, 1);
        fill(&mut writer, 2);
        // A mask in the making is not seen.
        writer.back().mask.words_mut().fill(99);
        let (seen, changed) = reader.newest().unwrap();
        assert_eq!((seen.frame, seen.mask.words()[0], changed), (FrameNumber(2), 2, true));
        assert!(!reader.newest().unwrap().1);
        fill(&mut writer, 3);
        assert_eq!(reader.newest().unwrap().0.mask.words(), [3; 4]);
    }

    #[test]
    fn masks_in_part_replace_nothing_but_themselves() {
        let (mut writer, mut reader) = mask_buffer(shape());
        let taken = |reader: &MaskReader| reader.taken().map(|mask| mask.frame.0).collect::<Vec<_>>();
        fill(&mut writer, 1);
        for frame in [2, 2, 3] {
            fill_in_part(&mut writer, frame);
        }
        assert_eq!(reader.newest().unwrap().0.frame, FrameNumber(3));
        assert_eq!(taken(&reader), [1, 2, 3]);
        fill_in_part(&mut writer, 4);
        fill(&mut writer, 5);
        assert!(reader.newest().unwrap().1);
        assert_eq!(taken(&reader), [5]);
        (6..26).for_each(|frame| fill_in_part(&mut writer, frame));
        assert!(reader.newest().unwrap().1 && !reader.newest().unwrap().1);
        assert_eq!(taken(&reader), (18..26).collect::<Vec<_>>());
        // Buffers go round.
        (26..99).for_each(|frame| fill_in_part(&mut writer, frame));
        reader.newest();
        assert!(reader.shared.lock().spare.len() <= 2 * max_layers(shape()));
    }

    #[test]
    fn waiting_passes_over_other_frames_and_ends_with_the_link() {
        let (mut writer, mut reader) = mask_buffer(shape());
        let soon = || Instant::now() + Duration::from_millis(20);
        fill(&mut writer, 4);
        assert_eq!(reader.wait_for(FrameNumber(5), soon()), Waited::TimedOut);
        let waiting = std::thread::spawn(move || {
            let waited = reader.wait_for(FrameNumber(5), Instant::now() + Duration::from_secs(60));
            (waited, reader)
        });
        fill(&mut writer, 5);
        let (waited, mut reader) = waiting.join().unwrap();
        assert_eq!((waited, reader.front().unwrap().frame), (Waited::Arrived, FrameNumber(5)));
        writer.end("server went away".into());
        drop(writer);
        let late = Instant::now() + Duration::from_secs(60);
        assert_eq!(reader.wait_for(FrameNumber(6), late), Waited::Ended("server went away".into()));
        assert_eq!(reader.ended().as_deref(), Some("server went away"));
    }

    #[test]
    fn a_loss_is_told_once_and_forgotten_with_the_next_mask() {
        let (mut writer, mut reader) = mask_buffer(shape());
        let soon = || Instant::now() + Duration::from_millis(20);
        writer.lose();
        assert_eq!(reader.wait_for(FrameNumber(1), soon()), Waited::Lost);
        assert_eq!(reader.wait_for(FrameNumber(1), soon()), Waited::TimedOut);
        writer.lose();
        fill(&mut writer, 1);
        assert_eq!(reader.wait_for(FrameNumber(1), soon()), Waited::Arrived);
        assert_eq!(reader.wait_for(FrameNumber(2), soon()), Waited::TimedOut);
    }

    #[test]
    fn no_mask_is_ever_torn() {
        let (mut writer, mut reader) = mask_buffer(MaskShape::new(64, 64, 4).unwrap());
        let writing = std::thread::spawn(move || (1..2000).for_each(|frame| fill(&mut writer, frame)));
        let mut last = 0;
        while !writing.is_finished() {
            if let Some((seen, _)) = reader.newest() {
                assert!(seen.mask.words().iter().all(|word| *word == u64::from(seen.frame.0)));
                assert!(seen.frame.0 >= last);
                last = seen.frame.0;
            }
        }
        writing.join().unwrap();
        assert_eq!(reader.newest().unwrap().0.frame, FrameNumber(1999));
    }
}
