//! Frames on the device, and the submissions that they are split into.

use std::{
    collections::VecDeque,
    ops::Range,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    time::{Duration, Instant},
};

use gnomon_protocol::mask::MaskShape;
use gnomon_shaders::host::TracedView;

use super::{movers::Posed, ring::Lease};

/// A frame whose last part is not yet submitted. Dropping it frees its slot.
#[derive(Debug)]
pub struct PartialSubmission {
    pub(super) lease: Lease,
    pub(super) shape: MaskShape,
    pub(super) view: TracedView,
    pub(super) begun_at: Instant,
    /// What moves, at the frame's time.
    pub(super) posed: Option<Posed>,
    /// Its region has just been written.
    pub(super) is_new: bool,
    /// Time that moving it took, in milliseconds.
    pub(super) pose_ms: f64,
    /// Tracing parts submitted.
    pub(super) parts: u32,
    /// Bytes of the mask whose copy to the host has been submitted.
    pub(super) copied_bytes: u64,
}

impl PartialSubmission {
    /// Rows of tiles that the next part traces if it should trace `rows`.
    #[must_use]
    pub fn next_rows(&self, rows: u32) -> Range<u32> {
        let first = self.view.first_row.min(self.shape.tiles_y());
        first..first.saturating_add(rows).min(self.shape.tiles_y())
    }

    /// Returns whether all rows are submitted. Pieces of the mask may still need copying.
    pub(super) fn is_traced(&self) -> bool {
        self.view.first_row >= self.shape.tiles_y()
    }
}

/// A wholly submitted frame.
#[derive(Debug)]
pub(super) struct InFlight {
    pub(super) lease: Lease,
    pub(super) shape: MaskShape,
    pub(super) begun_at: Instant,
    pub(super) pose_ms: f64,
    pub(super) parts: u32,
    /// Words of the mask that the host has read.
    pub(super) read_words: usize,
}

/// Submissions that may still be running.
#[derive(Debug, Default)]
pub(super) struct Submissions {
    waiting: VecDeque<wgpu::SubmissionIndex>,
    made: u64,
    /// When one was finished, or made while none was waiting.
    progress_at: Option<Instant>,
    /// Incremented by the device's callbacks.
    done: Arc<AtomicU64>,
}

impl Submissions {
    pub(super) fn add(&mut self, queue: &wgpu::Queue, commands: wgpu::CommandBuffer) {
        if self.waiting.is_empty() {
            self.progress_at = Some(Instant::now());
        }
        self.waiting.push_back(queue.submit([commands]));
        self.made += 1;
        let done = Arc::clone(&self.done);
        queue.on_submitted_work_done(move || _ = done.fetch_add(1, Ordering::Release));
    }

    /// Forgets finished submissions and returns the number of others.
    pub(super) fn count(&mut self) -> usize {
        let open = self.made - self.done.load(Ordering::Acquire).min(self.made);
        while self.waiting.len() as u64 > open {
            self.waiting.pop_front();
            self.progress_at = Some(Instant::now());
        }
        self.waiting.len()
    }

    /// Number of submissions not known to be finished.
    pub(super) fn waiting(&self) -> usize {
        self.waiting.len()
    }

    /// How long the device has worked on the oldest one.
    pub(super) fn oldest_age(&self) -> Duration {
        let since = self.progress_at.filter(|_| !self.waiting.is_empty());
        since.map_or(Duration::ZERO, |since| since.elapsed())
    }

    pub(super) fn oldest(&self) -> Option<wgpu::SubmissionIndex> {
        self.waiting.front().cloned()
    }
}
