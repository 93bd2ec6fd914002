//! The steps of a frame on the device: begin, submit whole or in parts, wait, collect.
//!
//! A part runs all kernels on a band of rows of tiles, or copies a piece of the mask to the host. Parts of different
//! frames may follow each other in any order: all data that outlives a part lies in the frame's own slot.

use std::time::{Duration, Instant};

use gnomon_protocol::mask::{Mask, MaskShape};
use gnomon_scene::{SceneAt, camera::Camera};
use gnomon_shaders::host::{TracedCounts, TracedView};

use super::{
    backend::ComputeBackend,
    kernels::Listed,
    ring::{RING_FRAMES, SLOTS, blocks},
    submission::{InFlight, PartialSubmission},
    timing::{PART_QUERIES, SLOT_QUERIES, Stages},
};
use crate::visibility::{RayShares, TraceCost, backend::BackendError, schedule::parts::MAX_PARTS};

/// Long masks are copied to the host, and read there, in pieces of this size, about 0.1 ms each.
const PIECE_BYTES: u64 = 8 * PIECE_WORDS as u64;
const PIECE_WORDS: usize = 1 << 17;

/// A kernel, and its workgroups across, down, and by light.
type Dispatch<'a> = (&'a wgpu::ComputePipeline, (u32, u32), u32);

/// Workgroups for the few blocks whose list did not do: one for each multiprocessor of a large GPU.
const REST_GROUPS: u32 = 128;

fn listed_work(kernels: &Listed, tiles: (u32, u32), lights: u32) -> Vec<Dispatch<'_>> {
    let blocks = blocks(tiles.0, tiles.1);
    vec![(&kernels.find, blocks, lights), (&kernels.test, blocks, lights + 1), (&kernels.rest, (REST_GROUPS, 1), 1)]
}

/// Rays that were not counted elsewhere are traced.
fn shares(counts: &TracedCounts) -> RayShares {
    let [proven_lit, proven_dark, listed] = [counts.proven_lit, counts.proven_dark, counts.listed].map(u64::from);
    let traced = u64::from(counts.rays).saturating_sub(proven_lit + proven_dark + listed);
    RayShares { proven_lit, proven_dark, listed, traced }
}

impl ComputeBackend {
    /// Frames wholly submitted and not collected.
    #[must_use]
    pub fn in_flight(&self) -> usize {
        self.in_flight.len()
    }

    /// Submissions that may still be running.
    pub fn submissions_open(&mut self) -> usize {
        if self.is_silent() { self.submissions.waiting() } else { self.submissions.count() }
    }

    /// How long the device has worked on the oldest submission that is not known to be finished.
    #[must_use]
    pub fn at_work_for(&self) -> Duration {
        self.submissions.oldest_age()
    }

    /// Frames that may begin now.
    #[must_use]
    pub fn free_slots(&self) -> usize {
        self.ring.as_ref().map_or(0, |ring| ring.slots.iter().filter(|slot| slot.is_free()).count())
    }

    /// Begins a frame of this state of the scene, without submitting anything; a number is a time in seconds. Puts what
    /// moves or was edited where it is then. The shape must fit ([`Self::fit`]).
    ///
    /// # Errors
    /// If [`SLOTS`] frames have begun, or the camera or the shape does not fit.
    pub fn begin(
        &mut self,
        camera: &Camera,
        scene: impl Into<SceneAt>,
        shape: MaskShape,
    ) -> Result<PartialSubmission, BackendError> {
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
        let mut view = TracedView::new(&basis, shape.width(), shape.height(), shape.lights(), self.nodes);
        let begun_at = Instant::now();
        let (mut posed, mut is_new) = (None, false);
        let (moving, scene) = (&mut self.moving, scene.into());
        if moving.movers.needs_region(&scene) {
            let at = moving.movers.at(lease.slot(), &scene);
            is_new = at.is_none();
            let now = at.unwrap_or_else(|| moving.pose(&self.gpu.queue, lease.slot(), &scene));
            (view.root, view.nodes, view.first_light) = (now.root, now.nodes, now.first_light);
            posed = Some(now);
        }
        let pose_ms = posed.map_or(0.0, |_| begun_at.elapsed().as_secs_f64() * 1e3);
        Ok(PartialSubmission { lease, shape, view, begun_at, posed, is_new, pose_ms, parts: 0, copied_bytes: 0 })
    }

    /// Submits the next part of a frame: `rows` rows of tiles, or a piece of its mask. Submits all of the rest if
    /// `rows` covers the frame. Returns the remaining work at once.
    ///
    /// # Errors
    /// If the device has failed, or the frame is cut into more than [`MAX_PARTS`] parts.
    pub fn submit_part(
        &mut self,
        mut frame: PartialSubmission,
        rows: u32,
    ) -> Result<Option<PartialSubmission>, BackendError> {
        let Some(ring) = &self.ring else { return Err(BackendError::Device("its buffers are gone".to_owned())) };
        let slot = &ring.slots[frame.lease.slot()];
        let shape = frame.shape;
        let first_query = SLOT_QUERIES * u32::try_from(frame.lease.slot()).unwrap_or_default();
        let mut encoder = self.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let (whole, traces) = (rows >= shape.tiles_y(), !frame.is_traced());
        if traces {
            if frame.parts >= MAX_PARTS {
                return Err(BackendError::Device(format!("a frame in more than {MAX_PARTS} parts")));
            }
            let first = first_query + PART_QUERIES * frame.parts;
            let mut begun = false;
            if frame.parts == 0 {
                slot.clear(&mut encoder);
                if let Some(posed) = frame.posed.filter(|_| frame.is_new) {
                    let begins = self.timing.as_ref().map(|timing| timing.begins(first));
                    begun = self.moving.build(&mut encoder, frame.lease.slot(), posed, begins);
                }
            }
            let rows = frame.next_rows(rows.max(1));
            frame.view.end_row = rows.end;
            let tiles = (shape.tiles_x(), rows.end - rows.start);
            for (stage, dispatches) in (0..).zip(self.work(shape, tiles)) {
                let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
                    label: None,
                    timestamp_writes: self
                        .timing
                        .as_ref()
                        .map(|timing| timing.writes(first, stage, begun && stage == 0)),
                });
                for (kernel, (x, y), z) in dispatches {
                    pass.set_pipeline(kernel);
                    pass.set_bind_group(0, self.scene(frame.lease.slot()), &[]);
                    pass.set_bind_group(1, &slot.group, &[]);
                    pass.set_immediates(0, bytemuck::bytes_of(&frame.view));
                    pass.dispatch_workgroups(x, y, z);
                }
            }
            frame.view.first_row = rows.end;
            frame.parts += 1;
        }
        // A long mask is copied piece by piece, each a part.
        let whole_mask = whole || slot.mask_bytes(shape) <= PIECE_BYTES;
        if frame.is_traced() && (whole_mask || !traces) {
            let piece = if whole_mask { u64::MAX } else { PIECE_BYTES };
            frame.copied_bytes += slot.copy_mask(&mut encoder, shape, frame.copied_bytes, piece);
        }
        let last = frame.copied_bytes >= slot.mask_bytes(shape);
        if last {
            slot.copy_counts(&mut encoder);
            if let Some(timing) = &self.timing {
                let end = PART_QUERIES * frame.parts;
                timing.write(&mut encoder, first_query + end);
                slot.copy_timestamps(&mut encoder, &timing.queries, first_query..first_query + end + 1);
            }
        }
        self.submissions.add(&self.gpu.queue, encoder.finish());
        if last {
            slot.map(shape);
        }
        self.check_device()?;
        if !last {
            return Ok(Some(frame));
        }
        let PartialSubmission { lease, shape, begun_at, pose_ms, parts, .. } = frame;
        self.in_flight.push_back(InFlight { lease, shape, begun_at, pose_ms, parts, read_words: 0 });
        Ok(None)
    }

    /// The kernels for a part of so many tiles, of primary and of shadow rays, each with its workgroups.
    fn work(&self, shape: MaskShape, tiles: (u32, u32)) -> [Vec<Dispatch<'_>>; 2] {
        let (kernels, lights) = (&self.kernels, shape.lights());
        match &kernels.lists {
            Some(lists) if self.uses_lists(shape.pixels()) => {
                [listed_work(&lists.primary, tiles, 1), listed_work(&lists.shadow, tiles, lights)]
            }
            _ => [vec![(&kernels.primary, tiles, 1)], vec![(&kernels.shadow, tiles, lights)]],
        }
    }

    /// Waits up to `patience` for the oldest submission.
    ///
    /// # Errors
    /// If the device has failed. It is unusable then.
    pub fn wait(&mut self, patience: Duration) -> Result<(), BackendError> {
        if self.is_silent() {
            std::thread::sleep(patience);
            return self.check_answers();
        }
        let waiting = match self.submissions.oldest() {
            Some(oldest) if !patience.is_zero() => {
                wgpu::PollType::Wait { submission_index: Some(oldest), timeout: Some(patience) }
            }
            _ => wgpu::PollType::Poll,
        };
        match self.gpu.device.poll(waiting) {
            Ok(_) | Err(wgpu::PollError::Timeout) => {}
            Err(error) => return Err(BackendError::Device(error.to_string())),
        }
        self.submissions.count();
        self.check_answers()?;
        self.check_device()
    }

    /// Returns whether the oldest frame in flight is in the host's memory.
    ///
    /// # Errors
    /// If the device failed to copy it.
    pub fn has_landed(&self) -> Result<bool, BackendError> {
        match (&self.ring, self.in_flight.front().filter(|_| !self.is_silent())) {
            (Some(ring), Some(oldest)) => ring.slots[oldest.lease.slot()].is_ready().map_err(BackendError::Device),
            _ => Ok(false),
        }
    }

    /// Collects the oldest frame in flight, waiting for the device up to `patience`. Returns `None` if there is none,
    /// it has not landed in time, or a piece of a long mask is left to read: call again then. Gives `mask` the frame's
    /// shape and writes every word.
    ///
    /// # Errors
    /// If the device has failed. It is unusable then.
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
        let (ticks, counts) = slot.finish(oldest.parts).map_err(BackendError::Device)?;
        let stages = match &self.timing {
            Some(timing) => timing.stages(&ticks),
            // Without a device clock, all of the time counts as tracing.
            None => {
                let shadow_ms = (seen_at - oldest.begun_at).as_secs_f64() * 1e3 - oldest.pose_ms;
                Stages { shadow_ms, ..Stages::default() }
            }
        };
        let cost = TraceCost {
            pose_ms: oldest.pose_ms,
            primary_ms: stages.primary_ms,
            shadow_ms: stages.shadow_ms,
            readback_ms: stages.copy_ms + seen_at.elapsed().as_secs_f64() * 1e3,
            primary_rays: oldest.shape.pixels() as u64,
            primary_listed: u64::from(counts.primary_listed),
            shadow_rays: u64::from(counts.rays),
            shares: shares(&counts),
        };
        self.in_flight.pop_front();
        Ok(Some(cost))
    }

    /// Submits a whole frame of this state of the scene; a number is a time in seconds. Returns at once. The shape must
    /// fit ([`Self::fit`]).
    ///
    /// # Errors
    /// If [`RING_FRAMES`] frames are in flight, the shape does not fit, or the device has failed.
    pub fn submit(&mut self, camera: &Camera, scene: impl Into<SceneAt>, shape: MaskShape) -> Result<(), BackendError> {
        if self.in_flight.len() >= RING_FRAMES {
            return Err(BackendError::Device(format!("{RING_FRAMES} frames are in flight already")));
        }
        let frame = self.begin(camera, scene, shape)?;
        self.submit_part(frame, u32::MAX).map(drop)
    }

    /// Traces one mask of the scene at time 0 and waits for it. `mask` must have the camera's size and a plane for each
    /// light of the scene.
    ///
    /// # Errors
    /// If the shape does not fit, frames are in flight, or the device has failed.
    pub fn trace(&mut self, camera: &Camera, mask: &mut Mask) -> Result<TraceCost, BackendError> {
        self.trace_at(camera, 0.0, mask)
    }

    /// As [`Self::trace`], of this state of the scene; a number is a time in seconds.
    ///
    /// # Errors
    /// Those of [`Self::trace`].
    pub fn trace_at(
        &mut self,
        camera: &Camera,
        scene: impl Into<SceneAt>,
        mask: &mut Mask,
    ) -> Result<TraceCost, BackendError> {
        if !self.in_flight.is_empty() {
            return Err(BackendError::Device(format!("{} frames are in flight", self.in_flight.len())));
        }
        let shape = mask.shape();
        if !self.fits(shape) {
            self.picture_limit().check(shape)?;
            self.fit([shape])?;
        }
        self.submit(camera, scene, shape)?;
        loop {
            if let Some(cost) = self.collect(Duration::from_secs(1), mask)? {
                return Ok(cost);
            }
        }
    }
}
