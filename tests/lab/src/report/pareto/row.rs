use super::{judge::Verdict, tracer::Traced};
use crate::report::statistics::median;

/// Rows of one group and one scene are compared with each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Group {
    Tracing,
    Prediction,
}

#[derive(Debug, Clone)]
pub(super) struct Row {
    pub(super) scene: String,
    pub(super) backend: String,
    pub(super) knob: String,
    pub(super) value: String,
    pub(super) group: Group,
    pub(super) ms_p50: f64,
    pub(super) ms_p99: f64,
    pub(super) rays: f64,
    pub(super) node_visits: Option<u64>,
    pub(super) bytes: f64,
    pub(super) bit_error: f64,
    pub(super) psnr_db: f64,
    pub(super) flip: f64,
    pub(super) on_front: bool,
    pub(super) is_default: bool,
}

impl Row {
    pub(super) fn new(
        [scene, backend, knob, value]: [&str; 4],
        (group, is_default): (Group, bool),
        traced: &[Traced],
        node_visits: Option<u64>,
        verdict: &Verdict,
    ) -> Self {
        let mut times: Vec<f64> = traced.iter().map(|traced| traced.ms).collect();
        times.sort_by(f64::total_cmp);
        #[expect(clippy::cast_precision_loss, reason = "counts are far below 2^53")]
        let mean = |of: fn(&Traced) -> u64| {
            traced.iter().map(|traced| of(traced) as f64).sum::<f64>() / traced.len().max(1) as f64
        };
        Self {
            scene: scene.to_owned(),
            backend: backend.to_owned(),
            knob: knob.to_owned(),
            value: value.to_owned(),
            group,
            ms_p50: median(&times).unwrap_or(f64::NAN),
            ms_p99: times.get(times.len().saturating_sub(1).min(times.len() * 99 / 100)).copied().unwrap_or(f64::NAN),
            rays: mean(|traced| traced.rays),
            node_visits,
            bytes: mean(|traced| traced.bytes),
            bit_error: verdict.bit_error(),
            psnr_db: verdict.psnr_db(),
            flip: verdict.flip(),
            on_front: false,
            is_default,
        }
    }
}
