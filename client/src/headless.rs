//! A headless run, from options to summary: open the adapter, get the scene, draw the frames, say how it went.

use std::{path::PathBuf, sync::Arc, time::Duration};

use gnomon_protocol::{codec::CodecId, mask::MaskShape, message::Welcome, reassembler::Policy};
use gnomon_shaders::{
    gpu::{Gpu, GpuOptions},
    scene::{LoadOptions, Scene},
};
use tokio::runtime::Runtime;

use crate::{
    camera_path::{CameraPath, PathSpec},
    default_path::default_path,
    error::ClientError,
    frame_loop::{FrameLoop, Outcome, Timing},
    guard::{Guard, GuardChoice},
    live::Live,
    mode::{Mode, ModeMachine, Thresholds},
    net::{
        reconnect::admit_patiently,
        session::{Admitted, Introduction, rate_hz},
        url::ServerUrl,
    },
    occluders::Occluders,
    pictures::PictureWriter,
    pose_history::HISTORY_FRAMES,
    predictor::Predictor,
    progress::Progress,
    render::{FrameRenderer, PICTURE_FORMAT, exposure::Exposure, readback::PictureReader},
    scene_cache::SceneCache,
    stats::{StatsFile, Summary, mean, percentile},
};

/// Most frames of a run.
pub const MAX_FRAMES: u32 = 10_000_000;

/// Frames a second that a path is cut into when neither `--frames` nor `--fps` says otherwise.
const DEFAULT_STEPS_PER_S: f64 = 30.0;

/// Pictures that may be under way on the adapter.
const PICTURES_AHEAD: usize = 2;

/// Threads for the network: one can decode while another one sends.
const NETWORK_THREADS: usize = 3;

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

/// Everything that a headless run can be told.
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
    /// File for the summary.
    pub summary: Option<PathBuf>,
    /// Folder for the encoded masks.
    pub save_masks: Option<PathBuf>,
    /// Token for servers that want one.
    pub token: Option<String>,
    /// Codec of the masks.
    pub codec: CodecId,
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
            summary: None,
            save_masks: None,
            token: None,
            codec: CodecId::PlanesLz4,
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
            connect_timeout: Duration::from_secs(5),
            progress: false,
        }
    }

    /// How each mask's guard band is chosen.
    fn guard_choice(&self) -> GuardChoice {
        GuardChoice::new(self.guard, (self.width, self.height))
    }

    fn looks_ahead(&self, gpu: &Gpu) -> bool {
        self.predict_pose.unwrap_or(!gpu.is_software())
    }

    /// Which packets make a frame: a client that waits for its own mask wants all of it.
    const fn policy(&self) -> Policy {
        if self.codec.is_sliced() && !self.wait { Policy::Slices } else { Policy::WholeFrame }
    }

    /// Width and height of the largest mask that is asked for.
    fn largest_mask(&self) -> (u32, u32) {
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
        if self.wait && matches!(self.source, Source::Offline { .. }) {
            return wrong("wait", "there is no mask to wait for without a server".to_owned());
        }
        Ok(())
    }
}

/// What the server agreed to, and the runtime that its tasks run on.
struct Connected {
    runtime: Runtime,
    admitted: Admitted,
}

/// Runs from start to end. Blocks; inside an asynchronous program, call it where blocking is allowed.
///
/// # Errors
/// With the one thing that kept the run from drawing all of its frames.
pub fn run_headless(options: &HeadlessOptions) -> Result<Summary, ClientError> {
    options.validate()?;
    // Cheap things that can fail come first, before a server is bothered.
    let camera_path = options.path.as_ref().map(CameraPath::load).transpose()?;
    let pictures = options.out.as_deref().map(PictureWriter::start).transpose()?;
    let stats = options.stats.as_deref().map(StatsFile::create).transpose()?;
    if let Some(folder) = &options.save_masks {
        std::fs::create_dir_all(folder).map_err(|source| ClientError::Write { path: folder.clone(), source })?;
    }
    let gpu = pollster::block_on(Gpu::open(&GpuOptions {
        adapter: options.adapter.clone(),
        allow_software: options.allow_software,
        ..GpuOptions::default()
    }))?;
    let progress = Progress::new(options.progress);
    let (scene, connected) = get_scene(options, &progress)?;
    let lights = u32::try_from(scene.lights.len()).unwrap_or(u32::MAX);
    let (width, height) = options.largest_mask();
    let shape = MaskShape::new(width, height, lights)?;

    let occluders = Occluders::largest_of(&scene);
    let camera_path = camera_path.unwrap_or_else(|| default_path(&scene, &occluders));
    let exposure = Exposure::of_scene(&scene, &occluders);
    let exposure = options.exposure_ev.map_or(exposure, |ev| exposure.at_ev(ev));
    let renderer =
        FrameRenderer::new(&gpu, &scene, (options.width, options.height), exposure, PICTURE_FORMAT, options.predictor)?;
    let picture_reader = PictureReader::new(&gpu, options.width, options.height, PICTURES_AHEAD);
    drop(scene);

    let welcome = connected.as_ref().map(|connected| connected.admitted.welcome.clone());
    let live =
        connected.map(|connected| start(connected, shape, options.policy(), options.save_masks.clone())).transpose()?;
    let timing = timing(options, &camera_path);
    let frame_loop = FrameLoop {
        renderer,
        picture_reader,
        camera_path: &camera_path,
        timing,
        size: (options.width, options.height),
        live,
        wait: options.wait,
        predict_pose: options.looks_ahead(&gpu),
        machine: ModeMachine::new(options.mode, options.thresholds),
        guard: options.guard_choice(),
        pictures,
        stats,
        progress: &progress,
    };
    let outcome = frame_loop.run()?;
    let summary = summary(options, &outcome, welcome.as_ref(), lights, exposure, &camera_path, &gpu);
    if let Some(path) = &options.summary {
        summary.write(path)?;
    }
    Ok(summary)
}

fn get_scene(options: &HeadlessOptions, progress: &Progress) -> Result<(Scene, Option<Connected>), ClientError> {
    match &options.source {
        Source::Offline { scene, lights_from, lights } => {
            let load = LoadOptions { lights_from: lights_from.clone(), max_lights: *lights };
            Ok((Scene::load(scene, &load)?, None))
        }
        Source::Server(url) => {
            let runtime = tokio::runtime::Builder::new_multi_thread()
                .worker_threads(NETWORK_THREADS)
                .thread_name("network")
                .enable_all()
                .build()?;
            let (width, height) = options.largest_mask();
            let introduction = Introduction {
                token: options.token.clone(),
                width,
                height,
                codec: options.codec,
                rate_hz: rate_hz(options.fps),
                resume: None,
                connect_timeout: options.connect_timeout,
            };
            let cache = SceneCache::new(options.cache_dir.clone());
            let (admitted, packed) = runtime.block_on(async {
                let mut admitted = admit_patiently(url, &introduction).await?;
                let packed = admitted.scene(&cache, |have, length| progress.fetching(have, length)).await?;
                Ok::<_, ClientError>((admitted, packed))
            })?;
            let scene = Scene::unpack(&packed)?;
            let (lights, said) = (scene.lights.len(), admitted.welcome.lights);
            if lights != said as usize {
                let reason = format!("it says {said} lights, and its scene has {lights}");
                return Err(ClientError::Protocol { url: Box::new(url.clone()), reason });
            }
            Ok((scene, Some(Connected { runtime, admitted })))
        }
    }
}

fn start(
    connected: Connected,
    shape: MaskShape,
    policy: Policy,
    save_masks: Option<PathBuf>,
) -> Result<Live, ClientError> {
    let Connected { runtime, admitted } = connected;
    let (session, masks) = runtime.block_on(admitted.start(shape, policy, save_masks))?;
    Ok(Live::new(Arc::new(runtime), session, masks))
}

fn timing(options: &HeadlessOptions, path: &CameraPath) -> Timing {
    let rest = (path.duration_s() - options.start_time_s).max(0.0);
    let frames = options.frames.unwrap_or_else(|| {
        let frames = (rest * options.fps.unwrap_or(DEFAULT_STEPS_PER_S)).round() + 1.0;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the range")]
        let frames = frames.clamp(1.0, f64::from(MAX_FRAMES)) as u32;
        frames
    });
    let step_s = match options.fps {
        Some(fps) => 1.0 / fps,
        None => rest / f64::from(frames.saturating_sub(1).max(1)),
    };
    Timing { frames, start_s: options.start_time_s, step_s, paced: options.fps.is_some() }
}

fn summary(
    options: &HeadlessOptions,
    outcome: &Outcome,
    welcome: Option<&Welcome>,
    lights: u32,
    exposure: Exposure,
    path: &CameraPath,
    gpu: &Gpu,
) -> Summary {
    let duration_s = outcome.duration.as_secs_f64().max(1e-9);
    let received = outcome.received;
    let of_each = |sum: u64| (received.frames > 0).then(|| sum as f64 / received.frames as f64);
    let transport = match &options.source {
        Source::Server(url) => url.transport.name(),
        Source::Offline { .. } => "offline",
    };
    Summary {
        frames_rendered: outcome.frames,
        frames_with_mask: outcome.frames_with_mask,
        frames_received: received.frames,
        frames_partial: received.partial,
        frames_incomplete: received.incomplete,
        frames_bad: received.bad,
        poses_repeated: outcome.poses_repeated,
        masks_rejected: outcome.rejections,
        degraded_share: welcome.map(|_| f64::from(outcome.frames_degraded) / f64::from(outcome.frames.max(1))),
        known_share_mean: mean(&outcome.known_shares),
        lag_frames_mean: mean(&outcome.lags),
        lag_frames_p50: percentile(&outcome.lags, 0.5),
        lag_frames_p99: percentile(&outcome.lags, 0.99),
        response_ms_mean: mean(&outcome.responses_ms),
        response_ms_p99: percentile(&outcome.responses_ms, 0.99),
        client_fps: f64::from(outcome.frames) / duration_s,
        visibility_fps: welcome.map(|_| (received.frames + received.partial) as f64 / duration_s),
        payload_bytes_mean: of_each(received.payload_bytes),
        packets_mean: of_each(received.packets),
        rtt_ms: outcome.round_trip.map(crate::stats::millis),
        duration_s,
        size: format!("{}x{}", options.width, options.height),
        lights,
        scene_digest: welcome.map(|welcome| welcome.scene_digest.to_string()),
        adapter: gpu.info.name.clone(),
        backend: welcome.map(|welcome| welcome.backend.clone()),
        codec: welcome.map(|_| options.codec.to_string()),
        transport: transport.to_owned(),
        wait: options.wait,
        predictor: options.predictor.to_string(),
        mode: options.mode,
        guard: options.guard.to_string(),
        predict_pose: options.looks_ahead(gpu),
        connection_lost: outcome.lost.clone(),
        reconnects: outcome.reconnects,
        exposure_ev: exposure.ev(),
        path: path.name().to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn options() -> HeadlessOptions {
        HeadlessOptions::new(Source::Offline { scene: "x.gltf".into(), lights_from: None, lights: None })
    }

    #[test]
    fn numbers_out_of_range_are_refused_before_anything_is_opened() {
        assert!(options().validate().is_ok());
        let change = |change: fn(&mut HeadlessOptions)| {
            let mut changed = options();
            change(&mut changed);
            run_headless(&changed).unwrap_err().to_string()
        };
        for (text, expected) in [
            (change(|o| o.width = 0), "0×720"),
            (change(|o| o.height = 4097), "1280×4097"),
            (change(|o| (o.width, o.height) = (4096, 4096)), "4096×4096"),
            (change(|o| o.frames = Some(0)), "--frames"),
            (change(|o| o.fps = Some(0.0)), "--fps"),
            (change(|o| o.fps = Some(f64::NAN)), "--fps"),
            (change(|o| o.start_time_s = -1.0), "--start-time"),
            (change(|o| o.exposure_ev = Some(f32::INFINITY)), "--exposure"),
            (change(|o| o.wait = true), "--wait"),
            (change(|o| o.thresholds.fade_s = -0.1), "--fade"),
            (change(|o| o.thresholds.fade_s = f64::NAN), "--fade"),
            (change(|o| o.thresholds.prediction_lag = 256), "--prediction-lag"),
            (change(|o| o.thresholds.sequential_lag = 101), "--sequential-lag"),
        ] {
            assert!(text.contains(expected), "{text}");
        }
    }

    #[test]
    fn frames_divide_the_path_or_keep_to_the_clock() {
        let key = |time_s: f64| crate::camera_path::Keyframe {
            time_s,
            position_m: glam::DVec3::ZERO,
            target_m: glam::DVec3::X,
        };
        let path = CameraPath::new("test", vec![key(0.0), key(4.0)], 1.0).unwrap();
        let with =
            |frames, fps, start_time_s| timing(&HeadlessOptions { frames, fps, start_time_s, ..options() }, &path);
        let times = |timing: Timing| (timing.frames, timing.time_s(0), timing.time_s(timing.frames - 1), timing.paced);
        assert_eq!(times(with(Some(5), None, 0.0)), (5, 0.0, 4.0, false));
        assert_eq!(times(with(Some(1), None, 1.0)), (1, 1.0, 1.0, false));
        assert_eq!(times(with(None, None, 0.0)), (121, 0.0, 4.0, false));
        assert_eq!(times(with(None, Some(10.0), 2.0)), (21, 2.0, 4.0, true));
        assert_eq!(times(with(Some(11), Some(2.0), 0.0)), (11, 0.0, 5.0, true));
    }
}
