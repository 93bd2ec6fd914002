//! The mask queue between two threads: the receive task publishes masks; the renderer takes or awaits them.

use std::{collections::VecDeque, sync::Arc, time::Instant};

use gnomon_client_core::mask::{queue::MaskQueue, received::ReceivedMask};
use gnomon_protocol::{ids::FrameNumber, mask::MaskShape};
use parking_lot::{Condvar, Mutex};

#[derive(Debug, Default)]
struct Shared {
    queue: Mutex<MaskQueue>,
    changed: Condvar,
}

impl Shared {
    fn end(&self, reason: String) {
        self.queue.lock().end(reason);
        self.changed.notify_all();
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
    /// The masks taken last, oldest first.
    front: VecDeque<ReceivedMask>,
}

/// How waiting for a mask ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Waited {
    /// The mask is in the front buffer.
    Arrived,
    TimedOut,
    /// A frame arrived only in part since the last mask, so the awaited one may never arrive.
    Lost,
    /// No more masks will arrive, with the reason.
    Ended(String),
}

/// Returns both ends of a buffer for masks of at most `shape`.
#[must_use]
pub fn mask_buffer(shape: MaskShape) -> (MaskWriter, MaskReader) {
    let shared = Arc::<Shared>::default();
    let reader = MaskReader { shared: Arc::clone(&shared), front: VecDeque::new() };
    (MaskWriter { shared, back: ReceivedMask::blank(shape, Instant::now()) }, reader)
}

impl MaskWriter {
    /// The back buffer, to be filled and published.
    pub fn back(&mut self) -> &mut ReceivedMask {
        &mut self.back
    }

    /// Passes the back buffer to the renderer; [`MaskQueue::publish`] tells which masks it replaces.
    pub fn publish(&mut self) {
        self.shared.queue.lock().publish(&mut self.back);
        self.shared.changed.notify_all();
    }

    /// Reports a frame that arrived only in part.
    pub fn lose(&self) {
        self.shared.queue.lock().report_loss();
        self.shared.changed.notify_all();
    }

    /// Reports that no more masks will arrive. The first reason is kept.
    pub fn end(&self, reason: String) {
        self.shared.end(reason);
    }

    /// Returns a handle that can end the masks from elsewhere.
    #[must_use]
    pub fn ender(&self) -> MaskEnder {
        MaskEnder { shared: Arc::clone(&self.shared) }
    }
}

#[derive(Debug, Clone)]
pub struct MaskEnder {
    shared: Arc<Shared>,
}

impl MaskEnder {
    /// The first reason is kept.
    pub fn end(&self, reason: String) {
        self.shared.end(reason);
    }
}

impl Drop for MaskWriter {
    fn drop(&mut self) {
        self.end("the receive task has stopped".to_owned());
    }
}

impl MaskReader {
    /// Takes the waiting masks, if there are any. Returns the newest mask and whether it is new.
    pub fn newest(&mut self) -> Option<(&ReceivedMask, bool)> {
        let changed = self.shared.queue.lock().take(&mut self.front);
        self.front().map(|front| (front, changed))
    }

    /// Returns the newest of the masks taken last.
    #[must_use]
    pub fn front(&self) -> Option<&ReceivedMask> {
        self.front.back()
    }

    /// Returns the masks taken last, oldest first: tiles missing from a newer one may be in an older one.
    pub fn taken(&self) -> impl Iterator<Item = &ReceivedMask> {
        self.front.iter()
    }

    /// Waits until `deadline` for the mask of exactly this frame. Skips others.
    pub fn wait_for(&mut self, frame: FrameNumber, deadline: Instant) -> Waited {
        self.wait_until(deadline, true, |front, _| front.frame == frame)
    }

    /// Waits until `deadline` for any new mask. A loss does not end the wait.
    pub fn wait_for_any(&mut self, deadline: Instant) -> Waited {
        self.wait_until(deadline, false, |_, fresh| fresh)
    }

    fn wait_until(
        &mut self,
        deadline: Instant,
        ends_on_loss: bool,
        is_awaited: impl Fn(&ReceivedMask, bool) -> bool,
    ) -> Waited {
        let shared = Arc::clone(&self.shared);
        let mut queue = shared.queue.lock();
        loop {
            let fresh = queue.take(&mut self.front);
            if self.front().is_some_and(|front| is_awaited(front, fresh)) {
                return Waited::Arrived;
            }
            if let Some(reason) = queue.ended() {
                return Waited::Ended(reason.to_owned());
            }
            if queue.take_loss() && ends_on_loss {
                return Waited::Lost;
            }
            if Instant::now() >= deadline {
                return Waited::TimedOut;
            }
            shared.changed.wait_until(&mut queue, deadline);
        }
    }

    /// Returns why no more masks will arrive, or `None` while they may.
    #[must_use]
    pub fn ended(&self) -> Option<String> {
        self.shared.queue.lock().ended().map(str::to_owned)
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

    #[test]
    fn the_renderer_sees_the_newest_published_mask() {
        let (mut writer, mut reader) = mask_buffer(shape());
        assert!(reader.newest().is_none() && reader.front().is_none());
        fill(&mut writer, 1);
        fill(&mut writer, 2);
        // A mask is not visible before it is published.
        writer.back().mask.words_mut().fill(99);
        let (seen, changed) = reader.newest().unwrap();
        assert_eq!((seen.frame, seen.mask.words()[0], changed), (FrameNumber(2), 2, true));
        assert!(!reader.newest().unwrap().1);
        fill(&mut writer, 3);
        assert_eq!(reader.newest().unwrap().0.mask.words(), [3; 4]);
    }

    #[test]
    fn waiting_skips_other_frames_and_ends_with_the_link() {
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
    fn a_loss_is_reported_once_and_cleared_by_the_next_mask() {
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
