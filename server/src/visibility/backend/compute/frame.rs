//! The way of a frame through the device: begun, submitted whole or in parts, waited for, read.
//!
//! A part is a band of rows of tiles, with both kernels, or a piece of the mask on its way to the host. Parts of different frames may
//! follow each other in any order, since all that outlives a part lies in the frame's own slot.

use std::{
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    time::{Duration, Instant},
};

use gnomon_protocol::mask::{Mask, MaskShape};
use gnomon_scene::camera::Camera;
use gnomon_shaders::host::TracedView;

use super::{
    ComputeBackend,
    ring::{Lease, RING_FRAMES, SLOTS},
    timing::{PART_QUERIES, SLOT_QUERIES, Stages},
};
use crate::visibility::{
    TraceCost,
    backend::{BackendError, sampling::Sampling},
    schedule::parts::MAX_PARTS,
};

/// What a part brings to the host of a long mask, and what is read there at a time: some 0.1 ms each.
const PIECE_BYTES: u64 = 8 * PIECE_WORDS as u64;
const PIECE_WORDS: usize = 1 << 17;

/// A frame whose last part is not submitted yet. Dropping it gives its place to another.
#[derive(Debug)]
pub struct Rest {
    lease: Lease,
    shape: MaskShape,
    view: TracedView,
    begun_at: Instant,
    /// Parts submitted that trace.
    parts: u32,
    copied_bytes: u64,
}

/// A frame that is wholly submitted.
#[derive(Debug)]
pub(super) struct InFlight {
    lease: Lease,
    shape: MaskShape,
    begun_at: Instant,
    parts: u32,
    read_words: usize,
}

/// What has been submitted and may not be done.
#[derive(Debug, Default)]
pub(super) struct Submissions {
    waiting: std::collections::VecDeque<wgpu::SubmissionIndex>,
    made: u64,
    /// Counted by the device's callbacks.
    done: Arc<AtomicU64>,
}

impl Submissions {
    fn add(&mut self, queue: &wgpu::Queue, commands: wgpu::CommandBuffer) {
        self.waiting.push_back(queue.submit([commands]));
        self.made += 1;
        let done = Arc::clone(&self.done);
        queue.on_submitted_work_done(move || _ = done.fetch_add(1, Ordering::Release));
    }

    fn open(&mut self) -> usize {
        let open = self.made - self.done.load(Ordering::Acquire).min(self.made);
        while self.waiting.len() as u64 > open {
            self.waiting.pop_front();
        }
        self.waiting.len()
    }
}

impl Rest {
    /// The rows of tiles that the next part traces, when so many are wanted.
    #[must_use]
    pub fn next_rows(&self, rows: u32) -> std::ops::Range<u32> {
        let first = self.view.first_row.min(self.shape.tiles_y());
        first..first.saturating_add(rows).min(self.shape.tiles_y())
    }

    /// Whether all rows are submitted; pieces of the mask may be left.
    fn is_traced(&self) -> bool {
        self.view.first_row >= self.shape.tiles_y()
    }
}

impl ComputeBackend {
    /// Frames wholly submitted and not collected.
    #[must_use]
    pub fn in_flight(&self) -> usize {
        self.in_flight.len()
    }

    /// Submissions that the device has not been seen to finish.
    pub fn submissions_open(&mut self) -> usize {
        self.submissions.open()
    }

    /// Frames that may be begun now.
    #[must_use]
    pub fn free_slots(&self) -> usize {
        self.ring.as_ref().map_or(0, |ring| ring.slots.iter().filter(|slot| slot.is_free()).count())
    }

    /// Begins a frame: nothing is submitted yet. [`Self::fit`] must have been told of the shape.
    ///
    /// # Errors
    /// When [`SLOTS`] frames have begun already, the shape does not fit, or the device has failed.
    pub fn begin(&mut self, camera: &Camera, shape: MaskShape) -> Result<Rest, BackendError> {
        if (camera.width, camera.height, self.lights) != (shape.width(), shape.height(), shape.lights()) {
            return Err(BackendError::Device(format!(
                "a camera of {}×{} pixels and {} lights for {shape:?}",
                camera.width, camera.height, self.lights
            )));
        }
        let Some(ring) = self.ring.as_ref().filter(|ring| ring.capacity.holds(shape)) else {
            return Err(BackendError::Device(format!("no buffers for {shape:?}")));
        };
        let Some(lease) = ring.lease() else {
            return Err(BackendError::Device(format!("{SLOTS} frames have begun already")));
        };
        let basis = camera.ray_basis(self.origin_m);
        let view = TracedView::new(&basis, shape.width(), shape.height(), shape.lights(), self.nodes);
        Ok(Rest { lease, shape, view, begun_at: Instant::now(), parts: 0, copied_bytes: 0 })
    }

    /// Submits the next part of a frame, so many rows of tiles or a piece of its mask; all that is left of it with as many rows as there
    /// are or more. Returns at once, with what is left then.
    ///
    /// # Errors
    /// When the device has failed, or the frame is cut into more than [`MAX_PARTS`] parts.
    pub fn submit_part(&mut self, mut rest: Rest, rows: u32) -> Result<Option<Rest>, BackendError> {
        let Some(ring) = &self.ring else { return Err(BackendError::Device("its buffers are gone".to_owned())) };
        let slot = &ring.slots[rest.lease.slot()];
        let shape = rest.shape;
        let first_query = SLOT_QUERIES * u32::try_from(rest.lease.slot()).unwrap_or_default();
        let mut encoder = self.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let (whole, traces) = (rows >= shape.tiles_y(), !rest.is_traced());
        if traces {
            if rest.parts >= MAX_PARTS {
                return Err(BackendError::Device(format!("a frame in more than {MAX_PARTS} parts")));
            }
            if rest.parts == 0 {
                slot.clear(&mut encoder);
            }
            let rows = rest.next_rows(rows.max(1));
            let first = first_query + PART_QUERIES * rest.parts;
            for (stage, (kernel, planes)) in
                (0..).zip([(&self.kernels.primary, 1), (&self.kernels.shadow, shape.lights())])
            {
                let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
                    label: None,
                    timestamp_writes: self.timing.as_ref().map(|timing| timing.writes(first, stage)),
                });
                pass.set_pipeline(kernel);
                pass.set_bind_group(0, &self.scene, &[]);
                pass.set_bind_group(1, &slot.group, &[]);
                pass.set_immediates(0, bytemuck::bytes_of(&rest.view));
                pass.dispatch_workgroups(shape.tiles_x(), rows.end - rows.start, planes);
            }
            rest.view.first_row = rows.end;
            rest.parts += 1;
        }
        // A piece of a long mask is a part of its own.
        let whole_mask = whole || slot.mask_bytes(shape) <= PIECE_BYTES;
        if rest.is_traced() && (whole_mask || !traces) {
            let piece = if whole_mask { u64::MAX } else { PIECE_BYTES };
            rest.copied_bytes += slot.copy_mask(&mut encoder, shape, rest.copied_bytes, piece);
        }
        let last = rest.copied_bytes >= slot.mask_bytes(shape);
        if last {
            slot.copy_work(&mut encoder);
            if let Some(timing) = &self.timing {
                let end = PART_QUERIES * rest.parts;
                timing.note(&mut encoder, first_query + end);
                slot.copy_timestamps(&mut encoder, &timing.queries, first_query..first_query + end + 1);
            }
        }
        self.submissions.add(&self.gpu.queue, encoder.finish());
        if last {
            slot.map(shape);
        }
        if let Some(reason) = self.failure.take() {
            return Err(BackendError::Device(reason));
        }
        if !last {
            return Ok(Some(rest));
        }
        let Rest { lease, shape, begun_at, parts, .. } = rest;
        self.in_flight.push_back(InFlight { lease, shape, begun_at, parts, read_words: 0 });
        Ok(None)
    }

    /// Waits up to `patience` for the oldest submission.
    ///
    /// # Errors
    /// When the device has failed: it cannot be used any more.
    pub fn wait(&mut self, patience: Duration) -> Result<(), BackendError> {
        let waiting = match self.submissions.waiting.front() {
            Some(oldest) if !patience.is_zero() => {
                wgpu::PollType::Wait { submission_index: Some(oldest.clone()), timeout: Some(patience) }
            }
            _ => wgpu::PollType::Poll,
        };
        match self.gpu.device.poll(waiting) {
            Ok(_) | Err(wgpu::PollError::Timeout) => {}
            Err(error) => return Err(BackendError::Device(error.to_string())),
        }
        self.submissions.open();
        self.failure.take().map_or(Ok(()), |reason| Err(BackendError::Device(reason)))
    }

    /// Whether the frame that was wholly submitted first has been seen to be in the host's memory.
    ///
    /// # Errors
    /// When the device has failed to bring it there.
    pub fn has_landed(&self) -> Result<bool, BackendError> {
        match (&self.ring, self.in_flight.front()) {
            (Some(ring), Some(oldest)) => ring.slots[oldest.lease.slot()].is_ready().map_err(BackendError::Device),
            _ => Ok(false),
        }
    }

    /// Collects the frame that was wholly submitted first, waiting for the device up to `patience`. `None` when there is none, or not in
    /// time, or when a long one has been read in part only: ask again. `mask` takes the frame's shape, and every word of it is written.
    ///
    /// # Errors
    /// When the device has failed: it cannot be used any more.
    pub fn collect(&mut self, patience: Duration, mask: &mut Mask) -> Result<Option<TraceCost>, BackendError> {
        if !self.has_landed()? {
            self.wait(patience)?;
            if !self.has_landed()? {
                return Ok(None);
            }
        }
        let (Some(ring), Some(oldest)) = (&self.ring, self.in_flight.front_mut()) else { return Ok(None) };
        let slot = &ring.slots[oldest.lease.slot()];
        let seen_at = Instant::now();
        if mask.shape() != oldest.shape {
            mask.reset(oldest.shape);
        }
        let words = oldest.read_words..oldest.shape.words().min(oldest.read_words + PIECE_WORDS);
        slot.read(mask, words.clone()).map_err(BackendError::Device)?;
        oldest.read_words = words.end;
        if words.end < oldest.shape.words() {
            return Ok(None);
        }
        let (ticks, work) = slot.finish(oldest.parts).map_err(BackendError::Device)?;
        let stages = match &self.timing {
            Some(timing) => timing.stages(&ticks),
            // Without a clock on the device, all of it counts as tracing.
            None => Stages { shadow_ms: (seen_at - oldest.begun_at).as_secs_f64() * 1e3, ..Stages::default() },
        };
        let cost = TraceCost {
            primary_ms: stages.primary_ms,
            shadow_ms: stages.shadow_ms,
            readback_ms: stages.copy_ms + seen_at.elapsed().as_secs_f64() * 1e3,
            primary_rays: oldest.shape.pixels() as u64,
            shadow_rays: if self.sampling == Sampling::All { work.wanted } else { work.traced },
        };
        self.node_visits = work.nodes;
        self.in_flight.pop_front();
        Ok(Some(cost))
    }

    /// Starts to trace a whole frame: returns at once. There must be fewer than [`RING_FRAMES`] in flight, and [`Self::fit`] must have
    /// been told of the shape.
    ///
    /// # Errors
    /// When one of these is not so, or the device has failed.
    pub fn submit(&mut self, camera: &Camera, shape: MaskShape) -> Result<(), BackendError> {
        if self.in_flight.len() >= RING_FRAMES {
            return Err(BackendError::Device(format!("{RING_FRAMES} frames are in flight already")));
        }
        let rest = self.begin(camera, shape)?;
        self.submit_part(rest, u32::MAX).map(drop)
    }

    /// Traces one mask and waits for it; for tests and measurements. `mask` must have the camera's size and a plane for
    /// each light of the scene.
    ///
    /// # Errors
    /// When the shape does not fit, frames are in flight, or the device has failed.
    pub fn trace(&mut self, camera: &Camera, mask: &mut Mask) -> Result<TraceCost, BackendError> {
        if !self.in_flight.is_empty() {
            return Err(BackendError::Device(format!("{} frames are in flight", self.in_flight.len())));
        }
        let shape = mask.shape();
        if !self.fits(shape) {
            self.picture_limit().check(shape)?;
            self.fit([shape])?;
        }
        self.submit(camera, shape)?;
        loop {
            if let Some(cost) = self.collect(Duration::from_secs(1), mask)? {
                return Ok(cost);
            }
        }
    }
}
