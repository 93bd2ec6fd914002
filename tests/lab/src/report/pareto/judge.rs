//! The error of a client's bits against the reference's, and of its picture against the picture with those bits.

use anyhow::{Context, Result};
use gnomon_client::predictor::Predictor;
use gnomon_protocol::mask::{Mask, MaskShape};
use gnomon_scene::{Scene, camera::Camera};
use image::RgbImage;

use super::viewer::{Shown, Viewer};
use crate::{
    metrics::{RelevantError, image::compare},
    reference::{Reference, Truth},
};

pub(super) struct Stop {
    pub(super) time_s: f64,
    pub(super) camera: Camera,
    truth: Truth,
    picture: RgbImage,
}

/// Sums over the shown frames.
#[derive(Debug, Clone, Default)]
pub(super) struct Verdict {
    bits: RelevantError,
    square: f64,
    flip: f64,
    pictures: u32,
}

impl Verdict {
    /// Wrong bits in per cent of the relevant ones, except bits that the reference cannot decide.
    pub(super) fn bit_error(&self) -> f64 {
        #[expect(clippy::cast_precision_loss, reason = "counts of bits are far below 2^53")]
        let [wrong, relevant] = [self.bits.wrong - self.bits.wrong_undecided, self.bits.relevant].map(|n| n as f64);
        100.0 * wrong / relevant.max(1.0)
    }

    /// PSNR of the mean square error of all pictures, in decibels; infinite if they equal the reference.
    pub(super) fn psnr_db(&self) -> f64 {
        -10.0 * (self.square / f64::from(self.pictures)).log10()
    }

    pub(super) fn flip(&self) -> f64 {
        self.flip / f64::from(self.pictures)
    }
}

impl Stop {
    /// Traces and draws the reference for `camera`.
    pub(super) fn new(
        (scene, referee): (&Scene, &Reference),
        viewer: &mut Viewer,
        (time_s, camera): (f64, Camera),
    ) -> Result<Self> {
        let truth = referee.trace(&camera);
        let lights = u32::try_from(scene.lights.len()).context("more lights than a mask has")?;
        let mut mask = Mask::new(MaskShape::new(camera.width, camera.height, lights)?);
        for (y, x) in (0..camera.height).flat_map(|y| (0..camera.width).map(move |x| (y, x))) {
            let lit = truth.at(x, y).lit;
            (0..lights).filter(|light| lit >> light & 1 == 1).for_each(|light| mask.set(light, x, y, true));
        }
        let picture = viewer.show(&camera, (&mask, &camera), Predictor::None)?.picture;
        Ok(Self { time_s, camera, truth, picture })
    }

    /// Adds the errors of a frame shown here.
    pub(super) fn judge(&self, shown: &Shown, verdict: &mut Verdict) {
        verdict.bits += RelevantError::of(&shown.bits, &self.truth);
        let error = compare(&shown.picture, &self.picture);
        verdict.square += 10.0_f64.powf(-error.psnr_db / 10.0);
        verdict.flip += error.flip;
        verdict.pictures += 1;
    }
}
