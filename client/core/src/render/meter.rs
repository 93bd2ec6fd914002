//! Exposure by what the camera sees: histograms of the picture's light, and the exposure that suits them.
//!
//! The adapter counts ten thousand pixels spread over the picture (`wgsl/shading/meter.wgsl`). White paint in the light
//! that a survey found would be shown as white, unless that makes the picture too dark or too bright.

use std::sync::OnceLock;

use gnomon_shaders::gpu::Gpu;

use super::{
    counts::Counts,
    error::RenderError,
    exposure::Exposure,
    pipeline::{bind_group, bind_group_layout, compute, compute_pipeline, picture, shader, storage},
    targets::Targets,
};

/// Workgroups of 16 × 16 pixels: 128 × 80 are counted.
const GROUPS: (u32, u32) = (8, 5);
const PIXELS: u32 = 128 * 80;

/// Bins of one histogram, each a quarter stop wide. The first begins at 2^−16.
const BINS: usize = 128;
const LOWEST_STOP: f32 = -16.0;
const BINS_PER_STOP: f32 = 4.0;

/// Least and most exposed luminance of the median surface: the sixth part and the third of white, and what the neutral
/// tone curve takes away. Snow stays brighter than coal, but both are seen.
const MIDDLE: (f32, f32) = (0.22, 0.33);

/// Shares of the picture, and the exposed luminance that no more than the rest may exceed. The tone curves reach white
/// between 6 and 9.
const HIGHLIGHTS: [(f32, f32); 2] = [(0.95, 4.0), (0.985, 12.0)];

/// Share of the picture below which surfaces do not count more than what lies behind them.
const FEW_SURFACES: f32 = 0.05;

/// The metered exposure is a multiple of this, so that rounding on another adapter does not change it.
const EV_STEP: f32 = 0.0625;

/// Time in which the eye gets used to most of a change.
const ADAPTATION_S: f64 = 0.4;

/// Difference from the metered exposure at which the eye begins to adapt, and at which it is content.
const NOTICED_EV: f32 = 0.25;
const CONTENT_EV: f32 = 0.03;

/// The eye goes at most this far from the exposure that the scene opened with.
const FARTHEST_EV: f32 = 5.0;

/// How often brightness occurs in a picture, surfaces and what lies behind them apart.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Histogram {
    surfaces: Vec<u32>,
    behind: Vec<u32>,
}

impl Histogram {
    fn new(mut words: Vec<u32>) -> Self {
        words.resize(2 * BINS, 0);
        let behind = words.split_off(BINS);
        Self { surfaces: words, behind }
    }

    fn all(&self) -> Vec<u32> {
        self.surfaces.iter().zip(&self.behind).map(|(surface, behind)| surface + behind).collect()
    }

    /// Returns the factor by which the light is to be multiplied: `incident` unless the picture says otherwise. The sky
    /// does not count if it `is_painted`, the same at any exposure.
    pub(crate) fn gain(&self, incident: f32, is_painted: bool) -> f32 {
        let counted = self.surfaces.iter().sum::<u32>();
        #[expect(clippy::cast_precision_loss, reason = "ten thousand at most")]
        let enough = counted as f32 >= FEW_SURFACES * PIXELS as f32;
        let key = if enough || is_painted { self.surfaces.clone() } else { self.all() };
        let whole = if is_painted { self.surfaces.clone() } else { self.all() };
        let limit = HIGHLIGHTS
            .iter()
            .filter_map(|(share, most)| percentile(&whole, *share).map(|luminance| most / luminance))
            .fold(f32::INFINITY, f32::min);
        let wanted =
            percentile(&key, 0.5).map_or(incident, |median| incident.max(MIDDLE.0 / median).min(MIDDLE.1 / median));
        wanted.min(limit)
    }
}

/// Returns the luminance below which this share lies. `None` if that is black.
fn percentile(counts: &[u32], share: f32) -> Option<f32> {
    let total: u32 = counts.iter().sum();
    #[expect(clippy::cast_precision_loss, reason = "ten thousand at most")]
    let wanted = total as f32 * share;
    let (mut below, mut stop) = (0.0, LOWEST_STOP);
    for (bin, count) in counts.iter().enumerate() {
        #[expect(clippy::cast_precision_loss, reason = "ten thousand at most")]
        let count = *count as f32;
        if count > 0.0 && below + count >= wanted {
            // The first bin takes all that is darker still.
            let within = (wanted - below) / count;
            return (bin > 0).then(|| (stop + within / BINS_PER_STOP).exp2());
        }
        below += count;
        stop += 1.0 / BINS_PER_STOP;
    }
    None
}

/// Returns `exposure`, changed to show light that is `gain` times as bright, as a whole number of steps.
pub(crate) fn corrected(exposure: Exposure, gain: f32) -> Exposure {
    let ev = exposure.ev() - gain.log2();
    exposure.at_ev(((ev / EV_STEP).round() * EV_STEP).clamp(-40.0, 40.0))
}

/// An eye that gets used to what it sees.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Eye {
    /// The exposure that the scene opened with, as an EV.
    opened_ev: f32,
    /// Exposure for the light that a survey found, as an EV.
    incident_ev: f32,
    wanted_ev: f32,
    adapts: bool,
}

impl Eye {
    pub(crate) fn new(exposure: Exposure, incident_ev: f32) -> Self {
        Self { opened_ev: exposure.ev(), incident_ev, wanted_ev: exposure.ev(), adapts: false }
    }

    /// Takes a histogram of light that was shown at `ev`.
    pub(crate) fn see(&mut self, histogram: &Histogram, ev: f32, is_painted: bool) {
        let wanted = ev - histogram.gain((ev - self.incident_ev).exp2(), is_painted).log2();
        self.wanted_ev = wanted.clamp(self.opened_ev - FARTHEST_EV, self.opened_ev + FARTHEST_EV);
    }

    /// Returns the EV that `ev` becomes in `step_s` seconds; the same while the eye is content.
    pub(crate) fn adapt(&mut self, ev: f32, step_s: f64) -> f32 {
        let away = self.wanted_ev - ev;
        self.adapts = away.abs() > if self.adapts { CONTENT_EV } else { NOTICED_EV };
        if !self.adapts {
            return ev;
        }
        #[expect(clippy::cast_possible_truncation, reason = "a share")]
        let share = (1.0 - (-step_s.max(0.0) / ADAPTATION_S).exp()) as f32;
        ev + away * share
    }
}

#[derive(Debug)]
pub(crate) struct MeterPass {
    layout: wgpu::BindGroupLayout,
    module: wgpu::ShaderModule,
    /// Compiled when light is first counted.
    pipeline: OnceLock<wgpu::ComputePipeline>,
    group: wgpu::BindGroup,
    /// With the EV that the light was exposed for.
    counts: Counts<f32>,
}

impl MeterPass {
    pub(crate) fn new(gpu: &Gpu, targets: &Targets) -> Result<Self, RenderError> {
        let device = &gpu.device;
        let bindings = [
            picture(wgpu::TextureSampleType::Float { filterable: false }),
            picture(wgpu::TextureSampleType::Uint),
            storage(false),
        ];
        let layout = bind_group_layout(device, "meter", wgpu::ShaderStages::COMPUTE, &bindings);
        let module = shader(gpu, "shading/meter.wgsl")?;
        let counts = Counts::new(device, "luminances", 2 * BINS as u64);
        let group = group(device, &layout, targets, &counts);
        Ok(Self { layout, module, pipeline: OnceLock::new(), group, counts })
    }

    pub(crate) fn resize(&mut self, device: &wgpu::Device, targets: &Targets) {
        self.group = group(device, &self.layout, targets, &self.counts);
    }

    /// Compiles what counting takes.
    pub(crate) fn compile(&self, device: &wgpu::Device) -> &wgpu::ComputePipeline {
        self.pipeline.get_or_init(|| compute_pipeline(device, &self.module, &[&self.layout], ("meter", &[])))
    }

    /// Counts the light of a picture exposed for `ev`, unless earlier counts are still on their way.
    pub(crate) fn encode(&mut self, device: &wgpu::Device, encoder: &mut wgpu::CommandEncoder, ev: f32) {
        if !self.counts.has_free_slot() {
            return;
        }
        self.counts.clear(encoder);
        let dispatch = |pass: &mut wgpu::ComputePass<'_>| pass.dispatch_workgroups(GROUPS.0, GROUPS.1, 1);
        compute(encoder, "meter", self.compile(device), &[&self.group], dispatch);
        self.counts.copy(encoder, ev);
    }

    /// Returns the newest histogram that has arrived since the last call, with its EV. Does not wait.
    pub(crate) fn take_newest(&mut self) -> Option<(Histogram, f32)> {
        self.counts.take_newest().map(|(words, ev)| (Histogram::new(words), ev))
    }

    /// As [`Self::take_newest`], but waits.
    ///
    /// # Errors
    /// If the adapter failed.
    pub(crate) fn wait(&mut self, gpu: &Gpu) -> Result<Option<(Histogram, f32)>, RenderError> {
        Ok(self.counts.wait(gpu)?.map(|(words, ev)| (Histogram::new(words), ev)))
    }
}

fn group(
    device: &wgpu::Device,
    layout: &wgpu::BindGroupLayout,
    targets: &Targets,
    counts: &Counts<f32>,
) -> wgpu::BindGroup {
    let view = wgpu::BindingResource::TextureView;
    bind_group(device, "meter", layout, &[view(&targets.light), view(&targets.normal_material), counts.binding()])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A histogram of these luminances and numbers of pixels.
    fn seen(surfaces: &[(f32, u32)], behind: &[(f32, u32)]) -> Histogram {
        let mut words = vec![0; 2 * BINS];
        for (offset, part) in [(0, surfaces), (BINS, behind)] {
            for (luminance, count) in part {
                #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "of a bin")]
                let bin = ((luminance.log2() - LOWEST_STOP) * BINS_PER_STOP) as usize;
                words[offset + bin] += count;
            }
        }
        Histogram::new(words)
    }

    /// A bin is a quarter stop wide.
    const BIN: f32 = 1.19;

    #[test]
    fn the_picture_is_as_bright_as_its_light_within_limits() {
        for luminance in [0.001, 0.25, 40.0] {
            let histogram = seen(&[(luminance, 5000), (luminance * 0.1, 2000), (luminance * 2.0, 2000)], &[]);
            let shown = |incident: f32| luminance * histogram.gain(incident / luminance, false);
            assert!((shown(0.26) - 0.26).abs() < 1e-4, "{luminance}");
            // Coal and snow.
            assert!((shown(0.01) / MIDDLE.0).log2().abs() < BIN.log2(), "{luminance}: {}", shown(0.01));
            assert!((shown(3.0) / MIDDLE.1).log2().abs() < BIN.log2(), "{luminance}: {}", shown(3.0));
        }
        assert_eq!(seen(&[], &[]).gain(0.7, false), 0.7);
    }

    #[test]
    fn highlights_keep_a_dark_picture_from_burning() {
        // A tenth of the picture is a lit window, five hundred times as bright as the room.
        let histogram = seen(&[(0.01, 9000), (5.0, 1000)], &[]);
        let shown = 5.0 * histogram.gain(1.0, false);
        assert!(shown < 4.0 * BIN && shown > 4.0 / BIN, "{shown}");
        // A lamp that is 1 % of it may burn.
        assert!(0.01 * seen(&[(0.01, 9900), (5.0, 100)], &[]).gain(1.0, false) > MIDDLE.0 / BIN);
    }

    #[test]
    fn a_painted_sky_does_not_count() {
        let room = [(0.1, 3000)];
        let with = seen(&room, &[(0.8, 7000)]);
        assert_eq!(with.gain(1.0, true), seen(&room, &[]).gain(1.0, true));
        // Nothing but sky.
        let shown = 8.0 * seen(&[], &[(8.0, 10_000)]).gain(1.0, false);
        assert!((shown / MIDDLE.1).log2().abs() < BIN.log2(), "{shown}");
    }

    #[test]
    fn an_eye_adapts_within_a_second_and_rests() {
        let mut eye = Eye::new(Exposure { scale: 1.0, reference_lux: 1.0 }, 0.0);
        eye.see(&seen(&[(1.0, 10_000)], &[]), 0.0, false);
        let wanted = -MIDDLE.1.log2();
        let (mut ev, mut last) = (0.0, 0.0);
        for _ in 0..60 {
            last = ev;
            ev = eye.adapt(ev, 1.0 / 60.0);
            assert!(ev >= last);
        }
        // A stop and a half too bright: e^−2.5 of the way is left after a second, and a bin is a quarter stop.
        assert!((ev - wanted).abs() < 0.25 + 0.1 * wanted, "{ev}");
        for _ in 0..600 {
            last = ev;
            ev = eye.adapt(ev, 1.0 / 60.0);
        }
        assert_eq!(ev, last);
        assert!((ev - wanted).abs() < 0.25 + CONTENT_EV, "{ev}");
    }

    #[test]
    fn an_eye_does_not_open_without_limit() {
        let mut eye = Eye::new(Exposure { scale: 1.0, reference_lux: 1.0 }, 0.0);
        eye.see(&seen(&[(1e-4, 10_000)], &[]), 0.0, false);
        let ev = (0..600).fold(0.0, |ev, _| eye.adapt(ev, 0.1));
        assert!((ev + FARTHEST_EV).abs() <= CONTENT_EV, "{ev}");
    }
}
