//! The device's clock: measures each stage of a frame.

use crate::visibility::schedule::parts::MAX_PARTS;

/// Timestamps of a part: begin and end of the primary kernel, then of the shadow kernel.
pub(super) const PART_QUERIES: u32 = 4;

/// Most timestamps of a frame: those of its parts, and the end of the copy.
pub(super) const SLOT_QUERIES: u32 = PART_QUERIES * MAX_PARTS + 1;

pub(super) const QUERY_BYTES: u64 = 8 * SLOT_QUERIES as u64;

#[derive(Debug)]
pub(super) struct Timing {
    /// [`SLOT_QUERIES`] for each frame in flight.
    pub(super) queries: wgpu::QuerySet,
    tick_ns: f64,
}

/// Device time by stage.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Stages {
    pub(super) primary_ms: f64,
    pub(super) shadow_ms: f64,
    pub(super) copy_ms: f64,
}

impl Timing {
    /// `None` if the device has no clock.
    pub(super) fn new(device: &wgpu::Device, queue: &wgpu::Queue, slots: u32) -> Option<Self> {
        device.features().contains(super::kernels::TIMING).then(|| Self {
            queries: device.create_query_set(&wgpu::QuerySetDescriptor {
                label: Some("stages"),
                ty: wgpu::QueryType::Timestamp,
                count: SLOT_QUERIES * slots,
            }),
            tick_ns: f64::from(queue.get_timestamp_period()),
        })
    }

    /// The timestamps that a pass writes. `stage` 0 is the primary kernel, 1 the shadow kernel. A stage that has
    /// `begun` with another pass has its first already.
    pub(super) fn writes(&self, first: u32, stage: u32, begun: bool) -> wgpu::ComputePassTimestampWrites<'_> {
        wgpu::ComputePassTimestampWrites {
            query_set: &self.queries,
            beginning_of_pass_write_index: (!begun).then_some(first + 2 * stage),
            end_of_pass_write_index: Some(first + 2 * stage + 1),
        }
    }

    /// The timestamp that a pass writes with which a part begins.
    pub(super) fn begins(&self, first: u32) -> wgpu::ComputePassTimestampWrites<'_> {
        wgpu::ComputePassTimestampWrites {
            query_set: &self.queries,
            beginning_of_pass_write_index: Some(first),
            end_of_pass_write_index: None,
        }
    }

    /// Records when all earlier commands are done.
    pub(super) fn write(&self, encoder: &mut wgpu::CommandEncoder, query: u32) {
        encoder.write_timestamp(&self.queries, query);
    }

    /// The stages of a frame. `ticks` are [`PART_QUERIES`] for each part, then the end of the copy.
    pub(super) fn stages(&self, ticks: &[u64]) -> Stages {
        stages(ticks, self.tick_ns)
    }
}

fn stages(ticks: &[u64], tick_ns: f64) -> Stages {
    // A clock that stepped back, or that power management reset, counts as zero time.
    #[expect(clippy::cast_precision_loss, reason = "2^53 ns are 104 days")]
    let ms = |from: u64, to: u64| to.saturating_sub(from) as f64 * tick_ns / 1e6;
    let (parts, end) = ticks.as_chunks::<{ PART_QUERIES as usize }>();
    let sum = |of: fn(&[u64; 4]) -> (u64, u64)| parts.iter().map(of).map(|(from, to)| ms(from, to)).sum();
    let traced = parts.last().map_or(0, |part| part[3]);
    Stages {
        primary_ms: sum(|part| (part[0], part[1])),
        shadow_ms: sum(|part| (part[2], part[3])),
        copy_ms: end.first().map_or(0.0, |end| ms(traced, *end)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stages_are_differences_in_milliseconds() {
        let whole = [1_000_000, 3_000_000, 3_100_000, 8_100_000, 8_200_000];
        assert_eq!(stages(&whole, 0.5), Stages { primary_ms: 1.0, shadow_ms: 2.5, copy_ms: 0.05 });
        // The time between two parts belongs to other frames.
        let parts =
            [1_000_000, 3_000_000, 3_100_000, 8_100_000, 50_000_000, 52_000_000, 52_000_000, 53_000_000, 53_100_000];
        assert_eq!(stages(&parts, 0.5), Stages { primary_ms: 2.0, shadow_ms: 3.0, copy_ms: 0.05 });
    }

    #[test]
    fn a_clock_that_steps_back_counts_as_no_time() {
        assert_eq!(stages(&[9, 4, 3, 3, 2], 1.0), Stages::default());
        assert_eq!(stages(&[], 1.0), Stages::default());
    }
}
