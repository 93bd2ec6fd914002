//! What the adapter takes for each stage of a frame, by its own clock. For measurements only.

use gnomon_shaders::gpu::Gpu;

use super::error::RenderError;

/// Features that an adapter needs for it.
pub const NEEDED: wgpu::Features =
    wgpu::Features::TIMESTAMP_QUERY.union(wgpu::Features::TIMESTAMP_QUERY_INSIDE_ENCODERS);

/// Times of one frame, at most.
const MOST: u32 = 16;

/// A clock that is read between stages.
#[derive(Debug)]
pub(crate) struct StageClock {
    times: wgpu::QuerySet,
    resolved: wgpu::Buffer,
    read: wgpu::Buffer,
    tick_ms: f64,
    /// What ended at each time; the first begins.
    names: Vec<&'static str>,
}

impl StageClock {
    /// Returns `None` if the device does not have [`NEEDED`].
    pub(crate) fn new(gpu: &Gpu) -> Option<Self> {
        if !gpu.device.features().contains(NEEDED) {
            return None;
        }
        let buffer = |usage| {
            gpu.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("times of stages"),
                size: u64::from(MOST) * 8,
                usage: usage | wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            })
        };
        Some(Self {
            times: gpu.device.create_query_set(&wgpu::QuerySetDescriptor {
                label: Some("times of stages"),
                ty: wgpu::QueryType::Timestamp,
                count: MOST,
            }),
            resolved: buffer(wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC),
            read: buffer(wgpu::BufferUsages::MAP_READ),
            tick_ms: f64::from(gpu.queue.get_timestamp_period()) * 1e-6,
            names: Vec::new(),
        })
    }

    /// Notes that the stage `name` ends, or the frame begins.
    pub(crate) fn mark(&mut self, encoder: &mut wgpu::CommandEncoder, name: &'static str) {
        // At most `MOST`.
        let place = u32::try_from(self.names.len()).unwrap_or(MOST);
        if place < MOST {
            encoder.write_timestamp(&self.times, place);
            self.names.push(name);
        }
    }

    /// Ends the frame.
    pub(crate) fn finish(&self, encoder: &mut wgpu::CommandEncoder) {
        encoder.resolve_query_set(&self.times, 0..u32::try_from(self.names.len()).unwrap_or(MOST), &self.resolved, 0);
        encoder.copy_buffer_to_buffer(&self.resolved, 0, &self.read, 0, None);
    }

    /// Returns the stages of the frame and their times in ms. Waits for the adapter.
    ///
    /// # Errors
    /// If the adapter failed.
    pub(crate) fn take(&mut self, gpu: &Gpu) -> Result<Vec<(&'static str, f64)>, RenderError> {
        let failed = |error: &dyn std::fmt::Display| RenderError::Device(error.to_string());
        self.read.map_async(wgpu::MapMode::Read, .., |_| ());
        gpu.device.poll(wgpu::PollType::wait_indefinitely()).map_err(|error| failed(&error))?;
        let times: Vec<u64> = {
            let bytes = self.read.get_mapped_range(..).map_err(|error| failed(&error))?;
            bytes.as_chunks().0.iter().map(|bytes| u64::from_le_bytes(*bytes)).collect()
        };
        self.read.unmap();
        let names = std::mem::take(&mut self.names);
        #[expect(clippy::cast_precision_loss, reason = "a frame is short")]
        let between = |pair: &[u64]| pair[1].saturating_sub(pair[0]) as f64 * self.tick_ms;
        Ok(names.into_iter().skip(1).zip(times.windows(2).map(between)).collect())
    }
}
