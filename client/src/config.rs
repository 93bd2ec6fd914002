//! The client's settings, each declared once. [`gnomon_settings`] reads them.

use std::{path::PathBuf, str::FromStr, time::Duration};

use gnomon_protocol::{codec::CodecId, limits::MAX_WRONG_PPM, reassembler::Policy};
use gnomon_settings::{Bounds as _, one_of};
use gnomon_shaders::gpu::Gpu;

use crate::{
    camera_path::PathSpec,
    environment::EnvironmentSpec,
    guard::{Guard, GuardChoice},
    link::receive_options::{Packets, Reception},
    mode::{Mode, Thresholds},
    pose_history::HISTORY_S,
    predictor::Predictor,
    render::{quality::Quality, tone::ToneCurve},
    target::Target,
};

/// Most frames of a headless run.
pub const MAX_FRAMES: u32 = 10_000_000;

const PPM_PER_PERCENT: f64 = 10_000.0;

const MAX_LOSSY_PERCENT: f64 = MAX_WRONG_PPM as f64 / PPM_PER_PERCENT;

const MODES: [Mode; 3] = [Mode::Auto, Mode::Concurrent, Mode::Sequential];

/// Settings for runs with and without a window. The doc comments are the `--help` texts.
#[derive(Debug, Clone, PartialEq, clap::Args)]
pub struct ClientSettings {
    /// URL that the server printed: gnomon://HOST:PORT/?cert=SHA256, or a scene's file, which a gnomon-server beside
    /// this program then serves [default in a window: the last server]
    #[arg(value_name = "URL|FILE")]
    pub url: Option<Target>,
    /// Camera path: a lights_camera.json file, and the path's name if it has several; or scene#NAME, a camera of the
    /// scene by its name or number [default: the scene's first camera, or a path to suit the scene]
    #[arg(long, value_name = "FILE[#NAME]", help_heading = "Picture")]
    pub path: Option<PathSpec>,
    /// Start time on the path, in s
    #[arg(long, value_name = "S", default_value_t = 0.0, bounds(0.0, 1e9), help_heading = "Picture")]
    pub start_time: f64,
    /// Size of the pictures, or initial size of the window, in pixels
    #[arg(long, value_name = "WxH", default_value = "1280x720", help_heading = "Picture")]
    pub size: Size,
    /// Exposure: 1 lux is shown as 2^-EV; the summary has the value used [default: to suit what the camera sees]
    #[arg(long, value_name = "EV", allow_negative_numbers = true, bounds(-40.0, 40.0_f32), help_heading = "Picture")]
    pub exposure: Option<f32>,
    /// Light around the scene: sky (from its sun), flat, none, or an equirectangular Radiance picture FILE.hdr
    #[arg(long, value_name = "ENVIRONMENT", default_value_t, help_heading = "Picture")]
    pub environment: EnvironmentSpec,
    /// Tone curve: how light becomes what a screen can show; none cuts off what is brighter
    #[arg(
        long, value_name = "CURVE", default_value_t, value_parser = one_of(ToneCurve::ALL), help_heading = "Picture"
    )]
    pub tone: ToneCurve,
    /// Frames to draw [default: once along the path]
    #[arg(long, value_name = "N", bounds(1, MAX_FRAMES), help_heading = "Headless runs")]
    pub frames: Option<u32>,
    /// Frames per second, in real time [default: as fast as possible, spread evenly over the path]
    #[arg(long, value_name = "F", bounds(0.001, 100_000.0), help_heading = "Headless runs")]
    pub fps: Option<f64>,
    /// Shade each frame with its own mask, and wait for it
    #[arg(long, help_heading = "Headless runs")]
    pub wait: bool,
    /// File with changes to the scene, a JSON line each: the time on the path in s, and what is changed then of a node
    /// or a light
    #[arg(long, value_name = "FILE", help_heading = "Headless runs")]
    pub edits: Option<PathBuf>,
    /// Folder for pictures: a PNG per frame, or in a window one per press of P
    #[arg(long, value_name = "DIR", help_heading = "Headless runs")]
    pub out: Option<PathBuf>,
    /// File for statistics, a JSON line per frame
    #[arg(long, value_name = "FILE", help_heading = "Headless runs")]
    pub stats: Option<PathBuf>,
    /// File for the summary, which is printed as well
    #[arg(long, value_name = "FILE", help_heading = "Headless runs")]
    pub summary: Option<PathBuf>,
    /// Folder for the encoded masks, a file per frame
    #[arg(long, value_name = "DIR", help_heading = "Headless runs")]
    pub save_masks: Option<PathBuf>,
    /// Log of received masks, one line each: frame, packets received or restored, packets restored, packets missing,
    /// digest of the decoded mask
    #[arg(long, value_name = "FILE", help_heading = "Headless runs")]
    pub mask_log: Option<PathBuf>,
    /// Token, for a server that requires one; --token-file and the variable hide it from other users of this machine
    #[arg(long, hide_env_values = true, value_name = "TOKEN", help_heading = "Server")]
    pub token: Option<String>,
    /// Codec of the masks
    #[arg(
        long, value_name = "CODEC", default_value_t = CodecId::TilesFast, value_parser = one_of(CodecId::ALL),
        help_heading = "Server"
    )]
    pub codec: CodecId,
    /// Share of mask bits that may be wrong where that saves bytes, in per cent
    #[arg(
        long,
        value_name = "PERCENT",
        default_value_t = 0.0,
        bounds(0.0, MAX_LOSSY_PERCENT),
        help_heading = "Server"
    )]
    pub lossy: f64,
    /// With ?cert=first-use: send the token on the first visit without asking who the server is
    #[arg(long, help_heading = "Server")]
    pub trust_first_use: bool,
    /// Folder for cached scenes [default: the platform's cache folder]
    #[arg(long, value_name = "DIR", help_heading = "Server")]
    pub cache_dir: Option<PathBuf>,
    /// Most MB of cached scenes, beside the one in use; those not used for longest go first
    #[arg(long, value_name = "MB", default_value_t = 8192, bounds(0, 100_000_000_u32), help_heading = "Server")]
    pub cache_limit: u32,
    /// Longest wait for the server's first answer, in s
    #[arg(long, value_name = "S", default_value_t = 5.0, bounds(0.001, 3600.0), help_heading = "Server")]
    pub connect_timeout: f64,
    /// What a lost packet of tiles-small or tiles-fast costs: its frame, its slice, or nothing once parity restores it
    #[arg(
        long, value_name = "WAY", default_value_t, value_parser = one_of(Packets::ALL),
        help_heading = "Late visibility"
    )]
    pub packets: Packets,
    /// How visibility is carried over to newer frames
    #[arg(
        long, value_name = "PREDICTOR", default_value_t,
        value_parser = one_of(Predictor::ALL.map(|(_, it)| it)), help_heading = "Late visibility"
    )]
    pub predict: Predictor,
    /// Pose to draw: the newest mask's (sequential), the newest (concurrent), or either, depending on the lag (auto)
    #[arg(long, value_name = "MODE", default_value_t, value_parser = one_of(MODES), help_heading = "Late visibility")]
    pub mode: Mode,
    /// Extra mask pixels around the picture, half on each side: auto, 0 or WxH
    #[arg(long, value_name = "WxH", default_value_t, help_heading = "Late visibility")]
    pub guard: Guard,
    /// Let the server trace for where the camera will be when the mask is shown [default: true on a GPU]
    #[arg(long, help_heading = "Late visibility")]
    pub predict_pose: Option<bool>,
    /// With --mode auto: largest lag that is drawn sequentially, in frames; 0 for never
    #[arg(
        long, value_name = "N", default_value_t = Thresholds::default().sequential_lag,
        help_heading = "Late visibility"
    )]
    pub sequential_lag: u32,
    /// With --mode auto: frames in a row with such a lag before sequential begins again
    #[arg(
        long, value_name = "N", default_value_t = Thresholds::default().calm_frames,
        help_heading = "Late visibility"
    )]
    pub calm_frames: u32,
    /// Largest age of visibility that is predicted over, in s; the dissertation has 50 frames
    #[arg(
        long, value_name = "S", default_value_t = Thresholds::default().prediction_lag_s,
        bounds(0.0, HISTORY_S), help_heading = "Late visibility"
    )]
    pub prediction_lag: f64,
    /// Duration of the fade when visibility becomes too late, and of the fade back, in s
    #[arg(
        long, value_name = "S", default_value_t = Thresholds::default().fade_s, bounds(0.0, 60.0),
        help_heading = "Late visibility"
    )]
    pub fade: f64,
    /// What to pay for smooth pictures: low or high
    #[arg(long, value_name = "QUALITY", default_value_t, value_parser = one_of(Quality::ALL), help_heading = "Picture")]
    pub quality: Quality,
    /// Synchronise pictures with the screen's refresh
    #[arg(long, default_value_t = true, help_heading = "Window")]
    pub vsync: bool,
    /// Start in full screen
    #[arg(long, help_heading = "Window")]
    pub full_screen: bool,
    /// Part of the graphics adapter's name [default: the first real GPU, or else software]
    #[arg(long, value_name = "NAME", help_heading = "Program")]
    pub adapter: Option<String>,
    /// Allow a software adapter
    #[arg(long, default_value_t = true, help_heading = "Program")]
    pub allow_software: bool,
}

impl Default for ClientSettings {
    fn default() -> Self {
        gnomon_settings::defaults()
    }
}

impl ClientSettings {
    #[must_use]
    pub const fn thresholds(&self) -> Thresholds {
        Thresholds {
            sequential_lag: self.sequential_lag,
            calm_frames: self.calm_frames,
            prediction_lag_s: self.prediction_lag,
            fade_s: self.fade,
        }
    }

    #[must_use]
    pub fn connect_timeout(&self) -> Duration {
        Duration::try_from_secs_f64(self.connect_timeout).unwrap_or(Duration::MAX)
    }

    /// In bytes.
    #[must_use]
    pub fn cache_limit(&self) -> u64 {
        u64::from(self.cache_limit) * 1_000_000
    }

    pub(crate) fn guard_choice(&self) -> GuardChoice {
        GuardChoice::new(self.guard, (self.size.width, self.size.height))
    }

    /// Returns whether the server traces for the predicted pose. By default it does unless the adapter is software.
    /// Such a mask's view was never drawn, so prediction must draw its depth: cheap on a GPU, but at least a tenth of
    /// the frame on a processor (`lab predict-cost`).
    pub(crate) fn looks_ahead(&self, gpu: &Gpu) -> bool {
        self.predict_pose.unwrap_or(!gpu.is_software())
    }

    /// In parts per million.
    pub(crate) fn wrong_ppm(&self) -> u16 {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the range")]
        let ppm = (self.lossy * PPM_PER_PERCENT).round().clamp(0.0, f64::from(MAX_WRONG_PPM)) as u16;
        ppm
    }

    /// Returns how frames are received. A client that waits for its own mask needs all of it, and only prediction by
    /// surface can find missing tiles in earlier masks.
    pub(crate) fn reception(&self) -> Reception {
        let in_part = self.codec.is_sliced()
            && !self.wait
            && self.packets != Packets::WholeFrame
            && self.predict == Predictor::Surface;
        Reception {
            policy: if in_part { Policy::Slices } else { Policy::WholeFrame },
            reports_losses: in_part && self.packets == Packets::Parity,
            save_masks: self.save_masks.clone(),
            mask_log: self.mask_log.clone(),
        }
    }

    /// Width and height of the largest mask to request.
    pub(crate) fn largest_mask(&self) -> (u32, u32) {
        let band = self.guard_choice().largest();
        (self.size.width + band.width, self.size.height + band.height)
    }
}

/// In pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Size {
    pub width: u32,
    pub height: u32,
}

impl FromStr for Size {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parse = || {
            let (width, height) = text.split_once(['x', '×'])?;
            Some(Self { width: width.parse().ok()?, height: height.parse().ok()? })
        };
        parse().ok_or_else(|| "must be WIDTHxHEIGHT in pixels, such as 1280x720".to_owned())
    }
}
