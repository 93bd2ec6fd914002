//! What the device says that a frame took, stage by stage.

/// Timestamps of a frame: begin and end of the primary kernel, of the shadow kernel, and the end of the copy.
pub(super) const QUERIES: u32 = 5;

/// Bytes of those timestamps.
pub(super) const QUERY_BYTES: u64 = 8 * QUERIES as u64;

/// The device's clock.
#[derive(Debug)]
pub(super) struct Timing {
    /// [`QUERIES`] for each frame in flight.
    pub(super) queries: wgpu::QuerySet,
    tick_ns: f64,
}

/// Time by stage, in milliseconds of the device.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Stages {
    pub(super) primary_ms: f64,
    pub(super) shadow_ms: f64,
    pub(super) copy_ms: f64,
}

impl Timing {
    /// The clock of a device that has one.
    pub(super) fn new(device: &wgpu::Device, queue: &wgpu::Queue, frames: u32) -> Option<Self> {
        device.features().contains(super::kernels::TIMING).then(|| Self {
            queries: device.create_query_set(&wgpu::QuerySetDescriptor {
                label: Some("stages"),
                ty: wgpu::QueryType::Timestamp,
                count: QUERIES * frames,
            }),
            tick_ns: f64::from(queue.get_timestamp_period()),
        })
    }

    /// Where a pass writes its begin and end: `stage` 0 is the primary kernel, 1 the shadow kernel.
    pub(super) fn writes(&self, first: u32, stage: u32) -> wgpu::ComputePassTimestampWrites<'_> {
        wgpu::ComputePassTimestampWrites {
            query_set: &self.queries,
            beginning_of_pass_write_index: Some(first + 2 * stage),
            end_of_pass_write_index: Some(first + 2 * stage + 1),
        }
    }

    /// Notes the end of the copy.
    pub(super) fn note_end(&self, encoder: &mut wgpu::CommandEncoder, first: u32) {
        encoder.write_timestamp(&self.queries, first + QUERIES - 1);
    }

    /// Milliseconds between a frame's timestamps.
    pub(super) fn stages(&self, ticks: [u64; QUERIES as usize]) -> Stages {
        stages(ticks, self.tick_ns)
    }
}

fn stages(ticks: [u64; QUERIES as usize], tick_ns: f64) -> Stages {
    // A clock that stepped back, or was reset by power management, counts as no time rather than as centuries.
    #[expect(clippy::cast_precision_loss, reason = "2^53 ns are 104 days")]
    let ms = |from: usize, to: usize| ticks[to].saturating_sub(ticks[from]) as f64 * tick_ns / 1e6;
    Stages { primary_ms: ms(0, 1), shadow_ms: ms(2, 3), copy_ms: ms(3, 4) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stages_are_differences_in_milliseconds() {
        let stages = stages([1_000_000, 3_000_000, 3_100_000, 8_100_000, 8_200_000], 0.5);
        assert_eq!(stages, Stages { primary_ms: 1.0, shadow_ms: 2.5, copy_ms: 0.05 });
    }

    #[test]
    fn a_clock_that_steps_back_counts_as_no_time() {
        assert_eq!(stages([9, 4, 3, 3, 2], 1.0), Stages::default());
    }
}
