//! A headless run.

use std::time::{Duration, Instant};

use gnomon_client_core::frame::frame_loop::{FrameLoop, MaskSource};
use gnomon_protocol::{ids::FrameNumber, mask::MaskShape, message::Welcome};
use gnomon_scene::camera::Camera;
use gnomon_shaders::gpu::{Gpu, GpuOptions};

use crate::{
    app::connect::{Loaded, Step, load},
    app::local_server::LocalServer,
    camera_path::{CameraPath, PathSpec},
    config::{ClientSettings, MAX_FRAMES, Size},
    error::ClientError,
    frame_driver::{FrameDriver, RunTotals, Shown, Sink, Stage},
    headless::edits::{Script, Timeline},
    headless::pictures::PictureWriter,
    headless::progress::Progress,
    headless::stats::{FrameStats, StatsFile, Summary, mean, percentile},
    link::{state::LinkState, url::Transport},
    mode::{ModeMachine, State},
    options::{HeadlessOptions, Source},
    record::Recorder,
    render::{FrameRenderer, PICTURE_FORMAT, exposure::Exposure, readback::PictureReader},
    stop::{Cause, Stop},
};

/// Frame rate along the path without `--frames` and `--fps`.
const DEFAULT_STEPS_PER_S: f64 = 30.0;

/// Pictures in flight on the adapter.
const PICTURES_AHEAD: usize = 2;

/// Blocks until the run ends.
///
/// # Errors
/// Errors if not all frames could be drawn, or a file could not be written.
pub fn run_headless(options: &HeadlessOptions) -> Result<Summary, ClientError> {
    run_headless_until(options, &Stop::default())
}

/// Blocks until the run ends, at the latest soon after `stop` is asked. The summary of a run that was asked to end is
/// that of the frames drawn until then.
///
/// # Errors
/// Errors if not all frames could be drawn, a file could not be written, or the run was asked to end before its first
/// frame.
pub fn run_headless_until(options: &HeadlessOptions, stop: &Stop) -> Result<Summary, ClientError> {
    let settings = &options.settings;
    let Size { width, height } = settings.size;
    options.validate()?;
    // First check what is cheap and can fail, before connecting to a server.
    let camera_path = settings.path.as_ref().map(PathSpec::load_file).transpose()?.flatten();
    let script = settings.edits.as_deref().map(Script::read).transpose()?;
    let pictures = settings.out.as_deref().map(PictureWriter::start).transpose()?;
    let stats = settings.stats.as_deref().map(StatsFile::create).transpose()?;
    if let Some(folder) = &settings.save_masks {
        std::fs::create_dir_all(folder).map_err(|source| ClientError::Write { path: folder.clone(), source })?;
    }
    if let Some(file) = &settings.mask_log {
        std::fs::File::create(file).map_err(|source| ClientError::Write { path: file.clone(), source })?;
    }
    let gpu = pollster::block_on(Gpu::open(&GpuOptions {
        adapter: settings.adapter.clone(),
        allow_software: settings.allow_software,
        ..GpuOptions::default()
    }))?;
    let progress = Progress::new(options.progress);
    let mut start = Start::new(options, (camera_path, script), &gpu, stop, &progress)
        // Leaving breaks what was under way.
        .map_err(|error| stop.asked().map_or(error, ClientError::from))?;

    let reader = PictureReader::new(&gpu, width, height, PICTURES_AHEAD);
    let mut files = Files { reader, pictures, stats };
    let mut tally = Tally::default();
    let mut run = Run { options, gpu: &gpu, stop, progress: &progress, tally: &mut tally };
    let drawn = run.draw_all(&mut start, &mut files);
    progress.finish();
    let Start { mut driver, welcome, lights, exposure, camera_path, local: _local, .. } = start;
    tally.duration = driver.frames.started().elapsed();
    let mut end = End {
        stopped_by: stop.asked(),
        loss: driver.link_state().and_then(|state| state.loss()).filter(|_| stop.asked().is_none()),
        totals: driver.leave(),
    };
    // Everything is finished whatever has failed before, and the first failure is told.
    let written = files.finish();
    let recorded = driver.recorder.take().map_or(Ok(()), Recorder::finish);
    let masks = end.totals.link.failure.take().map_or(Ok(()), Err);
    drawn.and(written).and(recorded).and(masks)?;
    let summary = summary(options, (&tally, &end), welcome.as_ref(), lights, exposure, &camera_path, &gpu);
    if let Some(path) = &settings.summary {
        summary.write(path)?;
    }
    Ok(summary)
}

/// All that a run has before its first frame.
struct Start {
    driver: FrameDriver,
    timing: Timing,
    camera_path: CameraPath,
    edits: Timeline,
    welcome: Option<Welcome>,
    lights: u32,
    exposure: Exposure,
    /// Ends after the session.
    local: Option<LocalServer>,
}

impl Start {
    fn new(
        options: &HeadlessOptions,
        (camera_path, script): (Option<CameraPath>, Option<Script>),
        gpu: &Gpu,
        stop: &Stop,
        progress: &Progress,
    ) -> Result<Self, ClientError> {
        let settings = &options.settings;
        let size = (settings.size.width, settings.size.height);
        let largest = settings.largest_mask();
        stop.check()?;
        let step = |step: Step<'_>| {
            if let Step::Fetching { have, length } = step {
                progress.fetching(have, length);
            }
        };
        // Nobody is there to be asked for trust.
        let Loaded { scene, connected, camera_path, look, local } =
            load(options, largest, camera_path, stop, step, |_, _| false)?;
        let lights = u32::try_from(scene.lights.len()).unwrap_or(u32::MAX);
        let shape = MaskShape::new(largest.0, largest.1, lights)?;
        let first = look.first_exposure();
        let mut renderer = FrameRenderer::new(gpu, &scene, size, first, PICTURE_FORMAT, settings.predict)?;
        let exposure = look.apply(&mut renderer, settings)?;
        renderer.set_quality(settings.quality);
        let edits = script.map_or(Ok(Timeline::default()), |script| script.of(&scene))?;
        drop(scene);
        let welcome = connected.as_ref().map(|connected| connected.welcome().clone());
        let recorder = Recorder::for_run(options, size, welcome.as_ref(), &renderer, gpu)?;
        stop.check()?;
        let link = connected.map(|connected| connected.start(shape, settings.reception())).transpose()?;
        let timing = timing(settings, &camera_path);
        let machine = ModeMachine::new(settings.mode, settings.thresholds());
        let source = match &link {
            None => MaskSource::Offline,
            Some(_) if settings.wait => MaskSource::Awaited,
            Some(_) => MaskSource::Streamed { look_ahead: settings.looks_ahead(gpu) },
        };
        let frames = FrameLoop::new(renderer, machine, settings.guard_choice(), source, Instant::now());
        let driver = FrameDriver::new(frames, link, recorder, timing.frames);
        Ok(Self { driver, timing, camera_path, edits, welcome, lights, exposure, local })
    }
}

/// How a run ended.
struct End {
    stopped_by: Option<Cause>,
    /// Why it had no server then.
    loss: Option<String>,
    totals: RunTotals,
}

/// When each frame is drawn.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Timing {
    frames: u32,
    start_s: f64,
    step_s: f64,
    /// True if frames are drawn in real time.
    paced: bool,
}

impl Timing {
    /// Returns the frame's time on the path, and that of the scene, in seconds.
    fn time_s(&self, frame: u32) -> f64 {
        self.start_s + f64::from(frame) * self.step_s
    }
}

struct Files {
    reader: PictureReader,
    pictures: Option<PictureWriter>,
    stats: Option<StatsFile>,
}

#[derive(Debug, Default)]
struct Tally {
    frames: u32,
    frames_with_mask: u32,
    frames_degraded: u32,
    lags: Vec<f64>,
    known_shares: Vec<f64>,
    responses_ms: Vec<f64>,
    duration: Duration,
}

impl Tally {
    fn add(&mut self, frame: &FrameStats, served: bool) {
        self.frames += 1;
        self.frames_with_mask += u32::from(frame.mask_frame.is_some());
        self.frames_degraded += u32::from(served && frame.state == State::Degraded);
        self.lags.extend(frame.lag.map(f64::from));
        self.responses_ms.extend(frame.response_ms);
        self.known_shares.extend(frame.known_share);
    }
}

/// A run that draws.
struct Run<'a> {
    options: &'a HeadlessOptions,
    gpu: &'a Gpu,
    stop: &'a Stop,
    progress: &'a Progress,
    tally: &'a mut Tally,
}

impl Run<'_> {
    /// Draws all frames, or those until the run is to end. What was drawn is read back even after an error.
    fn draw_all(&mut self, start: &mut Start, files: &mut Files) -> Result<(), ClientError> {
        start.driver.frames.restart(Instant::now());
        let drawn = (0..start.timing.frames).try_for_each(|index| self.draw_due(index, start, files));
        let drawn = match drawn {
            // A session that is left ends the wait for its mask.
            Err(ClientError::Stopped(_) | ClientError::Ended { .. }) if self.stop.asked().is_some() => Ok(()),
            drawn => drawn,
        };
        let read = files.write_rest();
        drawn.and(read)
    }

    /// Draws a frame when it is due, unless the run is to end.
    fn draw_due(&mut self, index: u32, start: &mut Start, files: &mut Files) -> Result<(), ClientError> {
        let Timing { paced, step_s, .. } = start.timing;
        if paced {
            let due = Duration::from_secs_f64(f64::from(index) * step_s);
            self.stop.sleep(due.saturating_sub(start.driver.frames.started().elapsed()));
        }
        self.stop.check()?;
        self.draw(index, start, files)
    }

    fn draw(&mut self, index: u32, start: &mut Start, files: &mut Files) -> Result<(), ClientError> {
        let Self { options: HeadlessOptions { settings, .. }, gpu, .. } = *self;
        let Start { driver, timing, camera_path, edits, .. } = start;
        let camera = camera_path.camera(timing.time_s(index), settings.size.width, settings.size.height);
        let scene_time_s = timing.time_s(index);
        let stage = Stage { gpu, settings, largest_mask: settings.largest_mask(), camera, scene_time_s };
        if let Some(new) = driver.maintain(FrameNumber(index), stage)? {
            (start.lights, start.exposure, start.welcome) = (new.welcome.lights, new.exposure, Some(new.welcome));
        }
        let due = edits.until(scene_time_s);
        if !due.is_empty() {
            driver.frames.edit(&due)?;
        }
        let drawn = driver.draw(FrameNumber(index), camera, scene_time_s, files)?;
        self.tally.add(&drawn, driver.link.is_some());
        if let Some(file) = &mut files.stats {
            file.write(&drawn)?;
        }
        match driver.link_state() {
            Some(LinkState::Fetching { have, length }) => self.progress.fetching(have, length),
            _ => self.progress.drawing(index + 1, timing.frames),
        }
        Ok(())
    }
}

impl Files {
    /// Waits for the oldest picture in flight and passes it to the writers. Returns whether there was one.
    fn write_oldest(&mut self) -> Result<bool, ClientError> {
        let Some(picture) = self.reader.take_oldest()? else { return Ok(false) };
        if let (Some(picture), Some(writer)) = (picture, &self.pictures) {
            writer.write(picture)?;
        }
        Ok(true)
    }

    fn write_rest(&mut self) -> Result<(), ClientError> {
        while self.write_oldest()? {}
        Ok(())
    }

    fn finish(self) -> Result<(), ClientError> {
        let pictures = self.pictures.map_or(Ok(()), PictureWriter::finish);
        let stats = self.stats.map_or(Ok(()), StatsFile::finish);
        pictures.and(stats)
    }
}

impl Sink for Files {
    fn show(
        &mut self,
        frame: FrameNumber,
        renderer: &mut FrameRenderer,
        camera: &Camera,
        visibility_share: f32,
    ) -> Result<Shown, ClientError> {
        let begun = Instant::now();
        let target = self.reader.target();
        let copied = self.pictures.is_some();
        let submission = renderer.shade(camera, visibility_share, &target, |encoder| {
            if copied {
                self.reader.copy(encoder);
            }
        })?;
        self.reader.submitted(frame.0.into(), submission, copied);
        let shade = begun.elapsed();
        while self.reader.is_full() {
            self.write_oldest()?;
        }
        Ok(Shown { shade, readback: begun.elapsed().saturating_sub(shade) })
    }
}

fn timing(settings: &ClientSettings, path: &CameraPath) -> Timing {
    let rest = (path.duration_s() - settings.start_time).max(0.0);
    let frames = settings.frames.unwrap_or_else(|| {
        let frames = (rest * settings.fps.unwrap_or(DEFAULT_STEPS_PER_S)).round() + 1.0;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the range")]
        let frames = frames.clamp(1.0, f64::from(MAX_FRAMES)) as u32;
        frames
    });
    let step_s = match settings.fps {
        Some(fps) => 1.0 / fps,
        None if rest > 0.0 => rest / f64::from(frames.saturating_sub(1).max(1)),
        // The camera stands, or moves with the scene, whose time goes on.
        None => 1.0 / DEFAULT_STEPS_PER_S,
    };
    Timing { frames, start_s: settings.start_time, step_s, paced: settings.fps.is_some() }
}

fn summary(
    options: &HeadlessOptions,
    (tally, end): (&Tally, &End),
    welcome: Option<&Welcome>,
    lights: u32,
    exposure: Exposure,
    path: &CameraPath,
    gpu: &Gpu,
) -> Summary {
    let settings = &options.settings;
    let Size { width, height } = settings.size;
    let duration_s = tally.duration.as_secs_f64().max(1e-9);
    let totals = &end.totals;
    let received = totals.link.received;
    let arrived = received.frames + received.cut;
    let mean_of = |sum: u64| (arrived > 0).then(|| sum as f64 / arrived as f64);
    let transport = match &options.source {
        Source::Server(url) => url.transport.name(),
        Source::File(_) => Transport::Quic.name(),
        Source::Offline(_) => "offline",
    };
    Summary {
        frames_rendered: tally.frames,
        frames_with_mask: tally.frames_with_mask,
        frames_received: received.frames,
        frames_cut: received.cut,
        frames_partial: received.partial,
        frames_incomplete: received.incomplete,
        frames_bad: received.bad,
        poses_repeated: totals.link.poses_repeated,
        masks_rejected: totals.rejections,
        degraded_share: welcome.map(|_| f64::from(tally.frames_degraded) / f64::from(tally.frames.max(1))),
        known_share_mean: mean(&tally.known_shares),
        lag_frames_mean: mean(&tally.lags),
        lag_frames_p50: percentile(&tally.lags, 0.5),
        lag_frames_p99: percentile(&tally.lags, 0.99),
        response_ms_mean: mean(&tally.responses_ms),
        response_ms_p99: percentile(&tally.responses_ms, 0.99),
        client_fps: f64::from(tally.frames) / duration_s,
        visibility_fps: welcome.map(|_| (arrived + received.partial) as f64 / duration_s),
        payload_bytes_mean: mean_of(received.payload_bytes),
        packets_mean: mean_of(received.packets),
        rtt_ms: totals.link.round_trip.map(crate::headless::stats::millis),
        duration_s,
        size: format!("{width}x{height}"),
        lights,
        scene_digest: welcome.map(|welcome| welcome.scene_digest.to_string()),
        adapter: gpu.info.name.clone(),
        backend: welcome.map(|welcome| welcome.backend.to_string()),
        codec: welcome.map(|_| settings.codec.to_string()),
        lossy_percent: settings.lossy,
        transport: transport.to_owned(),
        wait: settings.wait,
        predictor: settings.predict.to_string(),
        mode: settings.mode,
        guard: settings.guard.to_string(),
        predict_pose: settings.looks_ahead(gpu),
        connection_lost: totals.lost.clone(),
        reconnects: totals.link.reconnects,
        edits_refused: totals.edits_refused,
        lost_at_end: end.loss.clone(),
        stopped_by: end.stopped_by.map(Cause::name),
        exposure_ev: exposure.ev(),
        path: path.name().to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::app::local_server::LocalScene;

    fn options() -> HeadlessOptions {
        HeadlessOptions::new(Source::Offline(LocalScene::new("x.gltf".into())))
    }

    #[test]
    fn conflicting_options_are_refused_before_anything_is_opened() {
        assert!(options().validate().is_ok());
        let change = |change: fn(&mut ClientSettings)| {
            let mut changed = options();
            change(&mut changed.settings);
            run_headless(&changed).unwrap_err().to_string()
        };
        for (text, expected) in [
            (change(|s| s.size.width = 0), "0×720"),
            (change(|s| s.size.height = 4097), "1280×4097"),
            (change(|s| s.size = Size { width: 4096, height: 4096 }), "4096×4096"),
            (change(|s| s.wait = true), "--wait"),
            (change(|s| s.sequential_lag = 101), "--sequential-lag"),
        ] {
            assert!(text.contains(expected), "{text}");
        }
    }

    #[test]
    fn frames_divide_the_path_or_follow_the_clock() {
        let key = |time_s: f64| crate::camera_path::Keyframe {
            time_s,
            position_m: glam::DVec3::ZERO,
            target_m: glam::DVec3::X,
        };
        let path = CameraPath::new("test", vec![key(0.0), key(4.0)], 1.0).unwrap();
        let with = |frames, fps, start_time| {
            timing(&ClientSettings { start_time, frames, fps, ..ClientSettings::default() }, &path)
        };
        let standing = CameraPath::new("stands", vec![key(0.0)], 1.0).unwrap();
        let still = timing(&ClientSettings { frames: Some(4), ..ClientSettings::default() }, &standing);
        assert_eq!((still.time_s(0), still.time_s(3), still.paced), (0.0, 0.1, false));
        let times = |timing: Timing| (timing.frames, timing.time_s(0), timing.time_s(timing.frames - 1), timing.paced);
        assert_eq!(times(with(Some(5), None, 0.0)), (5, 0.0, 4.0, false));
        assert_eq!(times(with(Some(1), None, 1.0)), (1, 1.0, 1.0, false));
        assert_eq!(times(with(None, None, 0.0)), (121, 0.0, 4.0, false));
        assert_eq!(times(with(None, Some(10.0), 2.0)), (21, 2.0, 4.0, true));
        assert_eq!(times(with(Some(11), Some(2.0), 0.0)), (11, 0.0, 5.0, true));
    }
}
