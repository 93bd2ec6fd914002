//! How wrong the pictures of a run behind a network were: the client says of each which mask it was shaded with, so the same view,
//! mask and prediction are put together again, and the referee judges them.

use anyhow::{Context, Result};
use gnomon_client::{camera_path::CameraPath, mode::State, predictor::Predictor};
use gnomon_protocol::mask::Mask;
use gnomon_shaders::{
    camera::Camera,
    motion::{Extrapolation, Motion},
};
use serde::Deserialize;

use super::{predict_rig::PredictRig, prediction_error::PredictionError, scene_args::SceneArgs};

/// Poses before the mask's that the server's extrapolation is taken to have seen: none of them lost.
const POSES_BEFORE: usize = 12;

/// What a line of the client's statistics says of a picture.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub(super) struct Shown {
    pub(super) t_ms: f64,
    pub(super) state: State,
    visibility_share: f64,
    mask_frame: Option<u32>,
    pub(super) lag: Option<u32>,
    look_ahead_ms: u16,
}

/// A scene, and a path with a number of frames along it.
pub(super) struct Replay {
    rig: PredictRig,
    path: CameraPath,
    size: (u32, u32),
    /// From one frame to the next, on the path.
    step_s: f64,
}

impl Replay {
    pub(super) fn new(scene: &SceneArgs, fps: Option<f64>, allow_software: bool) -> Result<Self> {
        let path = scene.load_path()?;
        let step_s = fps.map_or_else(|| path.duration_s() / f64::from(scene.frames.max(2) - 1), f64::recip);
        let rig = PredictRig::new(&scene.load_scene()?, scene.size, allow_software)?;
        Ok(Self { rig, path, size: scene.size, step_s })
    }

    /// Wrong bits in per cent of the relevant ones, over `samples` pictures spread evenly over a run. A picture in the middle of
    /// a fade counts as what it shows more of.
    pub(super) fn bit_error(&mut self, run: &[Shown], samples: usize) -> Result<f64> {
        self.error_of(run, 0, samples, |_| Ok(None)).map(|error| error.wrong_percent())
    }

    /// As [`Self::bit_error`], of the pictures from `first` on, with the masks that were kept of the run.
    pub(super) fn error_of(
        &mut self,
        run: &[Shown],
        first: usize,
        samples: usize,
        kept: impl Fn(u32) -> Result<Option<Mask>>,
    ) -> Result<PredictionError> {
        let mut error = PredictionError::default();
        let pictures = run.len().saturating_sub(first);
        let samples = samples.min(pictures);
        for sample in 0..samples {
            let place = first + (2 * sample + 1) * pictures / (2 * samples);
            let shown = &run[place];
            let mask_frame = shown.mask_frame.and_then(|frame| usize::try_from(frame).ok());
            let frame = mask_frame.filter(|_| shown.state == State::Sequential).unwrap_or(place);
            let camera = self.camera(frame)?;
            let mask = match mask_frame.filter(|_| shown.visibility_share >= 0.5) {
                Some(frame) => {
                    let traced_for = self.traced_for(run, frame)?;
                    let mask = match shown.mask_frame.map(&kept).transpose()?.flatten() {
                        Some(mask) => mask,
                        None => self.rig.trace(&traced_for)?,
                    };
                    Some((mask, traced_for))
                }
                None => None,
            };
            let mask = mask.as_ref().map(|(mask, traced_for)| (mask, traced_for));
            let (_, visibility) = self.rig.draw(&camera, Predictor::Surface, mask)?;
            error.add(&visibility, &self.rig.truth(&camera));
        }
        Ok(error)
    }

    fn camera(&self, frame: usize) -> Result<Camera> {
        let frame = u32::try_from(frame).context("more frames than have numbers")?;
        Ok(self.path.camera(f64::from(frame) * self.step_s, self.size.0, self.size.1))
    }

    /// Where the server traced the mask that this frame asked for.
    fn traced_for(&self, run: &[Shown], frame: usize) -> Result<Camera> {
        let asked = run.get(frame).context("a mask of a frame that the run does not have")?;
        let mut motion = Motion::default();
        let first = frame.saturating_sub(POSES_BEFORE);
        for (number, sent) in run.iter().enumerate().take(frame + 1).skip(first) {
            motion.push(sent.t_ms / 1e3, self.camera(number)?);
        }
        let shown_s = (asked.t_ms + f64::from(asked.look_ahead_ms)) / 1e3;
        let ahead = motion.at(shown_s, Extrapolation::Velocity).filter(|_| asked.look_ahead_ms > 0);
        ahead.map_or_else(|| self.camera(frame), Ok)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn late_masks_and_none_are_worse_than_fresh_ones() {
        let asset = |name: &str| std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("assets").join(name);
        let args = SceneArgs {
            scene: asset("cloister.glb"),
            lights_from: None,
            lights: None,
            path: Some(format!("{}#walk", asset("cloister.json").display()).into()),
            size: (96, 54),
            frames: 300,
            out: "unused".into(),
        };
        let mut replay = Replay::new(&args, None, true).unwrap();
        let mut error = |lag: Option<u32>, state: State, look_ahead_ms: u16| {
            let frame = |frame: u32| Shown {
                t_ms: f64::from(frame) * 20.0,
                state,
                visibility_share: if state == State::Degraded { 0.0 } else { 1.0 },
                mask_frame: lag.map(|lag| frame.saturating_sub(lag)),
                lag,
                look_ahead_ms,
            };
            replay.bit_error(&(0..300).map(frame).collect::<Vec<_>>(), 4).unwrap()
        };
        let fresh = error(Some(0), State::Concurrent, 0);
        let late = error(Some(6), State::Concurrent, 0);
        let ahead = error(Some(6), State::Concurrent, 120);
        let own = error(Some(6), State::Degraded, 0);
        assert!(fresh < 0.02 && fresh < late && fresh < own, "{fresh} {late} {own}");
        assert!(ahead < late, "{ahead} {late}");
        // The picture of a mask's own frame is late, not wrong.
        assert!((error(Some(6), State::Sequential, 0) - fresh).abs() < 0.02);
        assert!((error(None, State::Degraded, 0) - own).abs() < 1e-9);
    }
}
