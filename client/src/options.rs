//! What a run can be told, in a window or without one, and which numbers are possible.

use std::{path::PathBuf, time::Duration};

use gnomon_protocol::{codec::CodecId, limits::MAX_WRONG_PPM, mask::MaskShape, reassembler::Policy};
use gnomon_shaders::gpu::Gpu;

use crate::{
    camera_path::PathSpec,
    error::ClientError,
    guard::{Guard, GuardChoice},
    link::{
        receive_options::{Packets, Reception},
        url::ServerUrl,
    },
    mode::{Mode, Thresholds},
    pose_history::HISTORY_FRAMES,
    predictor::Predictor,
};

/// Most frames of a headless run.
pub const MAX_FRAMES: u32 = 10_000_000;

/// Parts of a million in a per cent.
const PPM_PER_PERCENT: f64 = 10_000.0;

/// Where the scene and its visibility come from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Source {
    /// A server.
    Server(ServerUrl),
    /// A local file, drawn without visibility: every light reaches everything.
    Offline {
        /// The glTF file.
        scene: PathBuf,
        /// File whose lights are added.
        lights_from: Option<PathBuf>,
        /// Keep the first lights only.
        lights: Option<u32>,
    },
}

/// Everything that a headless run can be told. A window is told most of it, too.
#[derive(Debug, Clone, PartialEq)]
pub struct HeadlessOptions {
    /// Where the scene and its visibility come from.
    pub source: Source,
    /// The camera path; one that suits the scene without.
    pub path: Option<PathSpec>,
    /// Frames to draw; once along the path without.
    pub frames: Option<u32>,
    /// Frames a second, in real time. Without, frames follow each other as fast as they can, and divide the path evenly.
    pub fps: Option<f64>,
    /// Where on the path the first frame is, in seconds.
    pub start_time_s: f64,
    /// Width of the pictures, in pixels.
    pub width: u32,
    /// Height of the pictures, in pixels.
    pub height: u32,
    /// Folder for a PNG a frame.
    pub out: Option<PathBuf>,
    /// File for a JSON line a frame.
    pub stats: Option<PathBuf>,
    /// File for a recording.
    pub record: Option<PathBuf>,
    /// File for the summary.
    pub summary: Option<PathBuf>,
    /// Folder for the encoded masks.
    pub save_masks: Option<PathBuf>,
    /// File for a line a received mask.
    pub mask_log: Option<PathBuf>,
    /// Token for servers that want one.
    pub token: Option<String>,
    /// Codec of the masks.
    pub codec: CodecId,
    /// Bits of a frame that may be wrong where that spares bytes, in per cent; at most 1.
    pub lossy_percent: f64,
    /// What is done about lost packets.
    pub packets: Packets,
    /// Part of the graphics adapter's name.
    pub adapter: Option<String>,
    /// Whether a software adapter will do.
    pub allow_software: bool,
    /// Whether each frame waits for its own mask.
    pub wait: bool,
    /// How visibility is carried over to frames that it was not traced for.
    pub predictor: Predictor,
    /// How the pose to draw is chosen.
    pub mode: Mode,
    /// When that choice changes.
    pub thresholds: Thresholds,
    /// The guard band around each picture that masks have.
    pub guard: Guard,
    /// Whether the server traces for where the camera will be when the mask is shown. Without a choice it does unless the adapter
    /// is software: such a mask is of a view that was never drawn, so its depth has to be drawn for the prediction, which costs a
    /// GPU little and a processor a tenth of its frame and more (`lab predict-cost`).
    pub predict_pose: Option<bool>,
    /// Exposure that replaces the scene's own: 1 lux is shown as 2^−EV.
    pub exposure_ev: Option<f32>,
    /// Folder for cached scenes; the platform's without.
    pub cache_dir: Option<PathBuf>,
    /// Whether the server is remembered.
    pub remember: bool,
    /// How long the server may take to answer at first.
    pub connect_timeout: Duration,
    /// Whether a progress bar is drawn when standard error is a terminal.
    pub progress: bool,
}

impl HeadlessOptions {
    /// The options' defaults, for this source.
    #[must_use]
    pub fn new(source: Source) -> Self {
        Self {
            source,
            path: None,
            frames: None,
            fps: None,
            start_time_s: 0.0,
            width: 1280,
            height: 720,
            out: None,
            stats: None,
            record: None,
            summary: None,
            save_masks: None,
            mask_log: None,
            token: None,
            codec: CodecId::TilesFast,
            lossy_percent: 0.0,
            packets: Packets::default(),
            adapter: None,
            allow_software: true,
            wait: false,
            predictor: Predictor::default(),
            mode: Mode::default(),
            thresholds: Thresholds::default(),
            guard: Guard::default(),
            predict_pose: None,
            exposure_ev: None,
            cache_dir: None,
            remember: false,
            connect_timeout: Duration::from_secs(5),
            progress: false,
        }
    }

    /// How each mask's guard band is chosen.
    pub(crate) fn guard_choice(&self) -> GuardChoice {
        GuardChoice::new(self.guard, (self.width, self.height))
    }

    pub(crate) fn looks_ahead(&self, gpu: &Gpu) -> bool {
        self.predict_pose.unwrap_or(!gpu.is_software())
    }

    /// Bits of a frame that may be wrong, in parts of a million.
    pub(crate) fn wrong_ppm(&self) -> u16 {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the range")]
        let ppm = (self.lossy_percent * PPM_PER_PERCENT).round().clamp(0.0, f64::from(MAX_WRONG_PPM)) as u16;
        ppm
    }

    /// How frames are taken: a client that waits for its own mask wants all of it, and only prediction by surface looks up elsewhere what a
    /// mask lacks.
    pub(crate) fn reception(&self) -> Reception {
        let in_part = self.codec.is_sliced()
            && !self.wait
            && self.packets != Packets::WholeFrame
            && self.predictor == Predictor::Surface;
        Reception {
            policy: if in_part { Policy::Slices } else { Policy::WholeFrame },
            reports_losses: in_part && self.packets == Packets::Parity,
            save_masks: self.save_masks.clone(),
            mask_log: self.mask_log.clone(),
        }
    }

    /// Width and height of the largest mask that is asked for.
    pub(crate) fn largest_mask(&self) -> (u32, u32) {
        let band = self.guard_choice().largest();
        (self.width + band.width, self.height + band.height)
    }

    /// Checks what can be checked before anything is opened.
    ///
    /// # Errors
    /// When a number is out of range.
    pub fn validate(&self) -> Result<(), ClientError> {
        let wrong = |option, reason| Err(ClientError::Option { option, reason });
        MaskShape::new(self.width, self.height, 1)?;
        if self.frames.is_some_and(|frames| !(1..=MAX_FRAMES).contains(&frames)) {
            return wrong("frames", format!("{} frames: 1 to {MAX_FRAMES} can be drawn", self.frames.unwrap_or(0)));
        }
        if let Some(fps) = self.fps.filter(|fps| !(0.001..=100_000.0).contains(fps)) {
            return wrong("fps", format!("{fps} frames a second: 0.001 to 100000 are possible"));
        }
        if !(0.0..=1e9).contains(&self.start_time_s) {
            return wrong("start-time", format!("{} s: 0 to 1e9 are possible", self.start_time_s));
        }
        if let Some(ev) = self.exposure_ev.filter(|ev| !(-40.0..=40.0).contains(ev)) {
            return wrong("exposure", format!("{ev} EV: −40 to 40 are possible"));
        }
        let fade_s = self.thresholds.fade_s;
        if !(0.0..=60.0).contains(&fade_s) {
            return wrong("fade", format!("{fade_s} s: 0 to 60 are possible"));
        }
        let most = HISTORY_FRAMES - 1;
        if self.thresholds.prediction_lag > most {
            return wrong(
                "prediction-lag",
                format!("{} frames: the client remembers {most}", self.thresholds.prediction_lag),
            );
        }
        if self.thresholds.sequential_lag > self.thresholds.prediction_lag {
            let reason =
                format!("more than --prediction-lag {} is too late for any mode", self.thresholds.prediction_lag);
            return wrong("sequential-lag", reason);
        }
        let most_lossy = f64::from(MAX_WRONG_PPM) / PPM_PER_PERCENT;
        if !(0.0..=most_lossy).contains(&self.lossy_percent) {
            return wrong("lossy", format!("{} per cent: 0 to {most_lossy} are possible", self.lossy_percent));
        }
        if self.wait && matches!(self.source, Source::Offline { .. }) {
            return wrong("wait", "there is no mask to wait for without a server".to_owned());
        }
        Ok(())
    }
}

/// Everything that a window can be told.
#[derive(Debug, Clone, PartialEq)]
pub struct WindowOptions {
    /// What it has in common with a headless run. The size is the window's at first.
    pub run: HeadlessOptions,
    /// Whether pictures wait for the screen.
    pub vsync: bool,
    /// Whether the whole screen is taken.
    pub full_screen: bool,
    /// When to leave, from the start; never by itself without.
    pub exit_after: Option<Duration>,
}
