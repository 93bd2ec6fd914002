//! The command line and its environment variables. What is not said here may be said in the configuration file.

use std::{path::PathBuf, str::FromStr};

use clap::Parser;
use gnomon_protocol::codec::CodecId;

use crate::{
    camera_path::PathSpec,
    guard::Guard,
    link::{receive_options::Packets, url::ServerUrl},
    mode::Mode,
    predictor::Predictor,
};

/// The version, and the commit that the program is made of.
pub const VERSION: &str = concat!(env!("CARGO_PKG_VERSION"), env!("GNOMON_COMMIT"));

/// A thin client of a Gnomon server: rasterises a scene, and shades it with visibility that the server traces.
#[derive(Debug, Clone, Parser)]
#[command(name = "gnomon-client", version = VERSION, about, max_term_width = 120)]
pub struct Arguments {
    /// The line that the server printed: gnomon://HOST:PORT/?cert=SHA256
    #[arg(env = "GNOMON_URL", value_name = "URL")]
    pub url: Option<ServerUrl>,
    /// Draw into files instead of a window
    #[arg(long, help_heading = "What is shown")]
    pub headless: bool,
    /// Start the gnomon-server that lies beside this program, with the scene that this program carries, and look at it
    #[arg(long, conflicts_with_all = ["url", "offline", "headless"], help_heading = "What is shown")]
    pub demo: bool,
    /// Draw this glTF scene without a server: every light reaches everything
    #[arg(long, value_name = "SCENE", help_heading = "What is shown")]
    pub offline: Option<PathBuf>,
    /// With --offline: lights for a scene without any (a lights_camera.json file)
    #[arg(long, value_name = "FILE", requires = "offline", help_heading = "What is shown")]
    pub lights_from: Option<PathBuf>,
    /// With --offline: keep the first N lights
    #[arg(long, value_name = "N", requires = "offline", help_heading = "What is shown")]
    pub lights: Option<u32>,
    /// Camera path: a lights_camera.json file, and the path's name if it has several [default: one that suits the scene]
    #[arg(long, value_name = "FILE[#NAME]", help_heading = "What is shown")]
    pub path: Option<PathSpec>,
    /// Frames to draw [default: once along the path]
    #[arg(long, value_name = "N", help_heading = "Headless runs")]
    pub frames: Option<u32>,
    /// Frames a second, in real time [default: as fast as possible, with the frames spread evenly over the path]
    #[arg(long, value_name = "F", help_heading = "Headless runs")]
    pub fps: Option<f64>,
    /// Where on the path to begin, in seconds
    #[arg(long, value_name = "S", help_heading = "What is shown")]
    pub start_time: Option<f64>,
    /// Size of the pictures, or of the window at first, in pixels [default: 1280x720]
    #[arg(long, env = "GNOMON_SIZE", value_name = "WxH", help_heading = "What is shown")]
    pub size: Option<Size>,
    /// Folder for pictures: a PNG a frame, or from a window one for each press of P
    #[arg(long, value_name = "DIR", help_heading = "Headless runs")]
    pub out: Option<PathBuf>,
    /// File for a JSON line a frame
    #[arg(long, value_name = "FILE", help_heading = "Headless runs")]
    pub stats: Option<PathBuf>,
    /// File for a recording, which `lab replay` draws again
    #[arg(long, value_name = "FILE", help_heading = "What is shown")]
    pub record: Option<PathBuf>,
    /// File for the summary, which is printed as well
    #[arg(long, value_name = "FILE", help_heading = "Headless runs")]
    pub summary: Option<PathBuf>,
    /// Folder for the encoded masks, a file a frame
    #[arg(long, value_name = "DIR", help_heading = "Headless runs")]
    pub save_masks: Option<PathBuf>,
    /// Log of received masks, one line each: frame, packets received or restored, packets restored, packets missing
    #[arg(long, value_name = "FILE", help_heading = "Headless runs")]
    pub mask_log: Option<PathBuf>,
    /// Token, for a server that wants one
    #[arg(long, env = "GNOMON_TOKEN", hide_env_values = true, value_name = "TOKEN", help_heading = "Server")]
    pub token: Option<String>,
    /// Codec of the masks: words, words-lz4, planes-lz4, tiles-small or tiles-fast [default: tiles-fast]
    #[arg(long, env = "GNOMON_CODEC", value_name = "CODEC", help_heading = "Server")]
    pub codec: Option<CodecId>,
    /// Bits of a mask that may be wrong where that spares bytes, in per cent, up to 1 [default: 0]
    #[arg(long, env = "GNOMON_LOSSY", value_name = "PERCENT", help_heading = "Server")]
    pub lossy: Option<f64>,
    /// What is done about lost packets of tiles-small and tiles-fast: whole-frame, slices or parity [default: parity]
    #[arg(long, env = "GNOMON_PACKETS", value_name = "WAY", help_heading = "Late visibility")]
    pub packets: Option<Packets>,
    /// Part of the graphics adapter's name [default: the first real GPU, or else software]
    #[arg(long, env = "GNOMON_ADAPTER", value_name = "NAME", help_heading = "Program")]
    pub adapter: Option<String>,
    /// Whether a software adapter will do [default: true]
    #[arg(long, env = "GNOMON_ALLOW_SOFTWARE", value_name = "BOOL", num_args = 0..=1, require_equals = true, default_missing_value = "true", help_heading = "Program")]
    pub allow_software: Option<bool>,
    /// Shade each frame with exactly its own mask, and wait for it
    #[arg(long, help_heading = "Headless runs")]
    pub wait: bool,
    /// How visibility is carried over to newer frames: none, dissertation, dissertation-shadow, dissertation-copy or surface
    /// [default: surface]
    #[arg(long, env = "GNOMON_PREDICT", value_name = "PREDICTOR", help_heading = "Late visibility")]
    pub predict: Option<Predictor>,
    /// Which pose is drawn: the newest mask's (sequential), the newest (concurrent), or what the lag suggests (auto)
    /// [default: auto]
    #[arg(long, env = "GNOMON_MODE", value_name = "MODE", help_heading = "Late visibility")]
    pub mode: Option<Mode>,
    /// Extra pixels of the masks, half of them on each side: auto, 0 or WxH [default: 0]
    #[arg(long, env = "GNOMON_GUARD", value_name = "WxH", help_heading = "Late visibility")]
    pub guard: Option<Guard>,
    /// Whether the server traces for where the camera will be when the mask is shown [default: true on a GPU]
    #[arg(long, env = "GNOMON_PREDICT_POSE", value_name = "BOOL", num_args = 0..=1, require_equals = true, default_missing_value = "true", help_heading = "Late visibility")]
    pub predict_pose: Option<bool>,
    /// With --mode auto: the largest lag, in frames, that is drawn sequentially; 0 never is [default: 0]
    #[arg(long, env = "GNOMON_SEQUENTIAL_LAG", value_name = "N", help_heading = "Late visibility")]
    pub sequential_lag: Option<u32>,
    /// With --mode auto: frames in a row with such a lag before sequential begins again [default: 10]
    #[arg(long, env = "GNOMON_CALM_FRAMES", value_name = "N", help_heading = "Late visibility")]
    pub calm_frames: Option<u32>,
    /// The largest lag, in frames, that visibility is predicted over; the dissertation has 50 [default: 100]
    #[arg(long, env = "GNOMON_PREDICTION_LAG", value_name = "N", help_heading = "Late visibility")]
    pub prediction_lag: Option<u32>,
    /// How long received visibility takes to fade out when it is too late, and back in, in seconds [default: 0.25]
    #[arg(long, env = "GNOMON_FADE", value_name = "S", help_heading = "Late visibility")]
    pub fade: Option<f64>,
    /// Exposure: 1 lux is shown as 2^-EV; the summary says what was used [default: what suits the scene and its lights]
    #[arg(long, value_name = "EV", allow_negative_numbers = true, help_heading = "What is shown")]
    pub exposure: Option<f32>,
    /// Folder for cached scenes [default: the platform's cache folder]
    #[arg(long, env = "GNOMON_CACHE_DIR", value_name = "DIR", help_heading = "Server")]
    pub cache_dir: Option<PathBuf>,
    /// How long the server may take to answer at first, in seconds [default: 5]
    #[arg(long, env = "GNOMON_CONNECT_TIMEOUT", value_name = "S", help_heading = "Server")]
    pub connect_timeout: Option<f64>,
    /// Whether pictures wait for the screen [default: true]
    #[arg(long, env = "GNOMON_VSYNC", value_name = "BOOL", num_args = 0..=1, require_equals = true, default_missing_value = "true", help_heading = "Window")]
    pub vsync: Option<bool>,
    /// Take the whole screen
    #[arg(long, help_heading = "Window")]
    pub full_screen: bool,
    /// Leave after so long, in seconds: for scripts
    #[arg(long, value_name = "SECONDS", help_heading = "Window")]
    pub exit_after: Option<f64>,
    /// Configuration file (TOML); flags and environment variables go before it [default: client.toml in the platform's place]
    #[arg(long, env = "GNOMON_CLIENT_CONFIG", value_name = "FILE", help_heading = "Program")]
    pub config: Option<PathBuf>,
    /// Read the configuration, say what is wrong with it, and leave
    #[arg(long, help_heading = "Program")]
    pub check_config: bool,
    /// Print completions for this shell, and leave
    #[arg(long, value_name = "SHELL", help_heading = "Program")]
    pub completions: Option<clap_complete::Shell>,
    /// Print a man page, and leave
    #[arg(long, help_heading = "Program")]
    pub man: bool,
    /// What to log to standard error, as tracing's filters say it
    #[arg(long, env = "RUST_LOG", value_name = "FILTER", default_value = "warn", help_heading = "Program")]
    pub log: String,
}

/// Width and height, in pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Size {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
}

impl FromStr for Size {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parse = || {
            let (width, height) = text.split_once(['x', '×'])?;
            Some(Self { width: width.parse().ok()?, height: height.parse().ok()? })
        };
        parse().ok_or_else(|| format!("{text:?} is no size: WIDTHxHEIGHT in pixels is expected, 1280x720 for instance"))
    }
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory as _;

    use super::*;

    #[test]
    fn the_command_line_is_consistent() {
        Arguments::command().debug_assert();
        // Whoever reads the help finds every flag under a heading.
        let loose: Vec<_> = (Arguments::command().get_arguments())
            .filter(|argument| argument.get_help_heading().is_none() && argument.get_long().is_some())
            .map(|argument| argument.get_id().to_string())
            .collect();
        assert!(loose.is_empty(), "{loose:?}");
        let parse = |line: &str| Arguments::try_parse_from(line.split(' '));
        let parsed = parse("gnomon-client gnomon+lab-udp://127.0.0.1:5 --headless --size 640x360 --wait").unwrap();
        assert_eq!(parsed.size, Some(Size { width: 640, height: 360 }));
        assert!(parsed.wait && parsed.headless && parsed.allow_software.is_none());
        let parsed = parse("gnomon-client --allow-software --offline a.gltf --exposure -3.5").unwrap();
        assert_eq!((parsed.allow_software, parsed.exposure), (Some(true), Some(-3.5)));
        assert_eq!(parse("gnomon-client --allow-software=false").unwrap().allow_software, Some(false));
        let parsed =
            parse("gnomon-client --mode sequential --guard 128x72 --predict none --predict-pose --fade 0").unwrap();
        assert_eq!((parsed.mode, parsed.predict), (Some(Mode::Sequential), Some(Predictor::None)));
        assert_eq!((parsed.predict_pose, parsed.fade), (Some(true), Some(0.0)));
        assert_eq!(parsed.guard.map(|guard| guard.to_string()).as_deref(), Some("128x72"));
        for wrong in [
            "--mode fast",
            "--guard 63x36",
            "--predict all",
            "--size 640",
            "--size -1x3",
            "--codec zip",
            "--lights 3",
            "http://x:1",
            "--colour",
        ] {
            assert!(parse(&format!("gnomon-client {wrong}")).is_err(), "{wrong}");
        }
    }
}
