//! Settings and their outcomes.

use gnomon_client::{guard::GuardSize, predictor::Predictor};
use image::RgbImage;

use crate::{
    metrics::image::ImageError,
    report::{prediction_error::PredictionError, statistics::mean},
};

/// Which pose the server traces for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum PosePrediction {
    /// The newest pose.
    Off,
    /// The newest pose, extrapolated at constant velocity.
    Velocity,
}

impl PosePrediction {
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Off => "off",
            Self::Velocity => "velocity",
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Setting {
    pub(super) lag: u32,
    pub(super) predictor: Predictor,
    pub(super) guard: GuardSize,
    pub(super) predict_pose: PosePrediction,
}

#[derive(Debug, Default)]
pub(super) struct Outcome {
    pub(super) bits: PredictionError,
    pub(super) known_share: Vec<f64>,
    pub(super) images: Vec<ImageError>,
    pub(super) vmaf: Option<f64>,
    /// One picture per measured frame.
    pub(super) shown: Vec<RgbImage>,
}

impl Outcome {
    /// Returns the mean over the pictures whose error is finite; NaN if there is none.
    pub(super) fn mean_image(&self, of: fn(&ImageError) -> f64) -> f64 {
        mean(&self.images.iter().map(of).filter(|value| value.is_finite()).collect::<Vec<_>>())
    }
}
