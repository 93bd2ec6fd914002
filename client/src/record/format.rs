//! The records of a recording.

use gnomon_scene::{Edits, camera::Camera};
use serde::{Deserialize, Serialize};

use crate::{
    environment::EnvironmentSpec,
    headless::stats::FrameStats,
    predictor::Predictor,
    render::{debug_view::DebugView, quality::Quality, survey::Survey, tone::ToneCurve},
};

/// First line of the file, with the format's version.
pub const FIRST_LINE: &str = "gnomon recording 6\n";

/// Longest record: the largest mask, incompressible.
pub const MAX_RECORD_BYTES: u32 = 128 << 20;

pub const MAX_BYTES: u64 = 2 << 30;

#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct RecordedCamera {
    position_m: [f64; 3],
    orientation: [f64; 4],
    yfov_rad: f64,
    size_px: [u32; 2],
}

/// Settings of the renderer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Start {
    /// BLAKE3 digest of the packed scene; `None` offline.
    pub scene_digest: Option<String>,
    /// Width and height of the pictures, in pixels.
    pub size_px: [u32; 2],
    /// Exposed irradiance per lux, and the reference's irradiance in lux.
    pub exposure: [f32; 2],
    pub tone: ToneCurve,
    pub environment: EnvironmentSpec,
    pub survey: Survey,
    pub predictor: Predictor,
    pub quality: Quality,
    /// Graphics adapter. On another one, pictures may differ in their last bits.
    pub adapter: String,
}

/// Times of one frame, in milliseconds.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Timing {
    /// Since the first frame.
    pub t_ms: f64,
    pub surfaces_ms: f64,
    pub upload_ms: f64,
    pub shade_ms: f64,
    /// Waiting for the adapter or the screen.
    pub readback_ms: f64,
    /// Age of the mask, in frames.
    pub lag: Option<u32>,
    /// From sending a pose to receiving its mask, if this frame took a new mask.
    pub response_ms: Option<f64>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Record {
    /// Always first, and only there.
    Start(Start),
    /// New size of the pictures, in pixels.
    Size([u32; 2]),
    /// New predictor.
    Predictor(Predictor),
    /// New quality.
    Quality(Quality),
    /// New tone curve.
    Tone(ToneCurve),
    /// New exposure, as in [`Start`].
    Exposure([f32; 2]),
    /// Lights that are on, one bit each.
    LightsOn(u32),
    /// First column that is drawn without shadows.
    Split(Option<u32>),
    /// New debug view.
    View(DebugView),
    /// A mask was given to the renderer.
    Mask {
        /// Frame that requested it.
        frame: u32,
        /// View that it was traced for, and time of the scene in seconds, 0 if everything rests.
        traced_for: RecordedCamera,
        scene_time_s: f64,
        /// What people had changed in the scene.
        edits: Edits,
        /// In the codec `planes-lz4`.
        body: Vec<u8>,
        /// Tiles that had arrived, as `Coverage::words` returns them; `None` for all.
        coverage: Option<Vec<u32>>,
    },
    Frame {
        frame: u32,
        /// View from the newest pose.
        requested: RecordedCamera,
        shown: RecordedCamera,
        /// Time of the scene that is shown, in seconds.
        scene_time_s: f64,
        /// What people have changed in it.
        edits: Edits,
        /// Weight of received visibility, 0 to 1.
        visibility_share: f32,
        timing: Timing,
    },
    /// A network event.
    Event { frame: u32, text: String },
}

impl From<&Camera> for RecordedCamera {
    fn from(camera: &Camera) -> Self {
        Self {
            position_m: camera.position_m.to_array(),
            orientation: camera.orientation.to_array(),
            yfov_rad: camera.yfov_rad,
            size_px: [camera.width, camera.height],
        }
    }
}

impl From<&RecordedCamera> for Camera {
    fn from(camera: &RecordedCamera) -> Self {
        // Not normalised again, which could change the quaternion's last bits.
        Self {
            position_m: glam::DVec3::from_array(camera.position_m),
            orientation: glam::DQuat::from_array(camera.orientation),
            yfov_rad: camera.yfov_rad,
            width: camera.size_px[0],
            height: camera.size_px[1],
        }
    }
}

impl From<&FrameStats> for Timing {
    fn from(stats: &FrameStats) -> Self {
        Self {
            t_ms: stats.t_ms,
            surfaces_ms: stats.surfaces_ms,
            upload_ms: stats.upload_ms,
            shade_ms: stats.shade_ms,
            readback_ms: stats.readback_ms,
            lag: stats.lag,
            response_ms: stats.response_ms,
        }
    }
}
