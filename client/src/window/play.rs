//! A scene on the screen: poses from a person or the camera path, frames from the driver shared with headless runs.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use gnomon_client_core::{
    camera::of_scene,
    frame::frame_loop::{FrameLoop, MaskSource},
};
use gnomon_protocol::{ids::FrameNumber, limits::MAX_PIXELS, mask::MaskShape, message::Welcome};
use gnomon_scene::{SceneAt, camera::Camera};
use gnomon_shaders::gpu::Gpu;

use super::{
    background::Background,
    editing::Editing,
    reference::{self, Ready, Reference, local_scene},
    screen::Screen,
};
use crate::{
    app::{connect::Loaded, local_server::LocalServer},
    camera_path::CameraPath,
    config::ClientSettings,
    error::ClientError,
    frame_driver::{FrameDriver, NewScene, Stage},
    guard::{Guard, GuardChoice, GuardSize},
    headless::stats::{FrameStats, StatsFile},
    input::fly::{Fly, Motion},
    link::{receive::Received, state::LinkState, url::ServerUrl},
    mode::ModeMachine,
    options::HeadlessOptions,
    record::{Record, Recorder},
    render::{FrameRenderer, PICTURE_FORMAT, debug_view::DebugView},
    stop::Stop,
    window::{
        overlay::figures::Figures,
        settings::{Settings, Split},
    },
};

/// Time to cross the scene at the initial speed.
const CROSSING_S: f64 = 12.0;

/// Most initial speed: a drive. Farther is for the wheel.
const MOST_INITIAL_SPEED_M_PER_S: f64 = 20.0;

/// The window must keep a new size for this long before pictures are resized; until then they are stretched.
const RESIZE_DELAY: Duration = Duration::from_millis(150);

pub(crate) struct Play {
    pub(super) driver: FrameDriver,
    /// `None` if the server does not let this client edit the scene.
    pub(crate) editing: Option<Editing>,
    /// The server's URL and its Welcome.
    pub(crate) server: Option<(ServerUrl, Welcome)>,
    pub(crate) figures: Figures,
    pub(crate) fly: Fly,
    camera_path: CameraPath,
    /// True if the camera follows the path, not the person.
    follows_path: bool,
    /// Of the scene's file.
    scene_cameras: Vec<CameraPath>,
    /// The one of them that is followed instead of the path.
    followed: Option<CameraPath>,
    /// Time on the path.
    path_s: f64,
    next: u32,
    applied: Settings,
    view: DebugView,
    /// Largest picture, in pixels.
    largest: (u32, u32),
    /// The window's size, and since when it has had it.
    window_size: ((u32, u32), Instant),
    stats: Option<StatsFile>,
    options: HeadlessOptions,
    stop: Stop,
    reference: LocalReference,
    /// A message to show once.
    pub(crate) message: Option<String>,
    /// The server of a file that was opened. It ends after the session.
    _local: Option<LocalServer>,
}

enum LocalReference {
    Off,
    Starting(Background<Ready>),
    Drawing(Box<Reference>),
}

/// Returns the largest mask that will be requested for pictures of at most `picture` pixels.
pub(crate) fn largest_mask(picture: (u32, u32)) -> (u32, u32) {
    // The person may choose a guard band later.
    let band = GuardSize { width: 640, height: 360 }.around(picture);
    (picture.0 + band.width, picture.1 + band.height)
}

/// Shrinks a size to the largest allowed for pictures, keeping its aspect ratio.
pub(crate) fn fitted((width, height): (u32, u32), largest: (u32, u32)) -> (u32, u32) {
    let (width, height) = (f64::from(width.max(1)), f64::from(height.max(1)));
    let side = (f64::from(largest.0) / width).min(f64::from(largest.1) / height);
    let scale = side.min((f64::from(MAX_PIXELS) / (width * height)).sqrt()).min(1.0);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "not larger than before")]
    let scaled = |side: f64| (side * scale).floor().max(1.0) as u32;
    (scaled(width), scaled(height))
}

impl Play {
    /// Starts the session, with pictures as large as the screen.
    pub(crate) fn start(
        screen: &Screen,
        loaded: Loaded,
        options: &HeadlessOptions,
        largest: (u32, u32),
        settings: &mut Settings,
        stop: Stop,
    ) -> Result<Self, ClientError> {
        let Loaded { scene, connected, camera_path, look, local } = loaded;
        let lights = u32::try_from(scene.lights.len()).unwrap_or(u32::MAX);
        (settings.lights, settings.lights_on) = (lights, all_of(lights));
        settings.set_cameras(&scene.cameras);
        let size = fitted(screen.size(), largest);
        let first = look.first_exposure();
        let mut renderer = FrameRenderer::new(&screen.gpu, &scene, size, first, PICTURE_FORMAT, settings.predictor)?;
        look.apply(&mut renderer, &options.settings)?;
        // Both may have been chosen during loading.
        renderer.set_predictor(settings.predictor);
        renderer.set_tone(settings.tone);
        renderer.set_quality(settings.quality);
        let extent_m = f64::from((scene.bounds.max - scene.bounds.min).length());
        let speed = (extent_m / CROSSING_S).min(MOST_INITIAL_SPEED_M_PER_S);
        let (width, height) = largest_mask(largest);
        let shape = MaskShape::new(width, height, lights)?;
        let server = connected.as_ref().map(|connected| (connected.url().clone(), connected.welcome().clone()));
        // Files before the session: a failure here leaves no session open.
        let welcome = server.as_ref().map(|(_, welcome)| welcome);
        let recorder = Recorder::for_run(options, size, welcome, &renderer, &screen.gpu)?;
        let stats = options.settings.stats.as_deref().map(StatsFile::create).transpose()?;
        let link = connected.map(|connected| connected.start(shape, options.settings.reception())).transpose()?;
        let machine = ModeMachine::new(settings.mode, options.settings.thresholds());
        let guard = GuardChoice::new(settings.guard, size);
        let source = match &link {
            None => MaskSource::Offline,
            Some(_) => MaskSource::Streamed { look_ahead: options.settings.looks_ahead(&screen.gpu) },
        };
        let frames = FrameLoop::new(renderer, machine, guard, source, Instant::now());
        let driver = FrameDriver::new(frames, link, recorder, u32::MAX);
        let first = camera_path.camera(options.settings.start_time, size.0, size.1);
        let scene_cameras = of_scene::paths(&scene);
        Ok(Self {
            editing: driver.frames.matcher.world.may_edit().then(|| Editing::new(scene)),
            driver,
            server,
            figures: Figures::default(),
            fly: Fly::from_camera(&first, speed),
            camera_path,
            scene_cameras,
            followed: None,
            follows_path: false,
            path_s: options.settings.start_time,
            next: 0,
            // The renderer does not have the settings chosen during loading.
            applied: Settings { split: Split::Off, ..settings.clone() },
            view: DebugView::Picture,
            largest,
            window_size: (size, Instant::now()),
            stats,
            options: options.clone(),
            stop,
            reference: LocalReference::Off,
            message: None,
            _local: local,
        })
    }

    /// Switches between the camera path and the person, who continues from the camera's current position.
    pub(crate) fn toggle_path(&mut self) {
        if self.follows_path {
            self.stand(&self.path_camera(self.scene_time_s(), self.size()));
        } else {
            self.follows_path = true;
        }
    }

    fn stand(&mut self, camera: &Camera) {
        self.fly = Fly::from_camera(camera, self.fly.speed_m_per_s());
        (self.followed, self.follows_path) = (None, false);
    }

    /// Time of the scene, in seconds.
    pub(super) fn scene_time_s(&self) -> f64 {
        self.options.settings.start_time + self.driver.frames.started().elapsed().as_secs_f64()
    }

    fn path_camera(&self, scene_time_s: f64, (width, height): (u32, u32)) -> Camera {
        let path = self.followed.as_ref().unwrap_or(&self.camera_path);
        let time_s = if path.follows_scene() { scene_time_s } else { self.path_s };
        path.camera(time_s, width, height)
    }

    /// Moves the camera to where the next frame is drawn from, `step_s` seconds after the last.
    pub(crate) fn step(&mut self, motion: &Motion, step_s: f64) {
        if self.follows_path {
            self.path_s += step_s;
        } else {
            self.fly.step(motion, step_s);
        }
    }

    /// The next frame's camera.
    pub(super) fn camera(&self, scene_time_s: f64) -> Camera {
        let (width, height) = self.size();
        let path = self.follows_path.then(|| self.path_camera(scene_time_s, (width, height)));
        path.unwrap_or_else(|| self.fly.camera(width, height))
    }

    /// Draws the next frame, `step_s` seconds after the last. The camera has been moved.
    pub(crate) fn frame(
        &mut self,
        screen: &mut Screen,
        settings: &mut Settings,
        step_s: f64,
    ) -> Result<FrameStats, ClientError> {
        let (width, height) = self.size();
        let scene_time_s = self.scene_time_s();
        let stage = Stage {
            gpu: &screen.gpu,
            settings: &self.options.settings,
            largest_mask: largest_mask(self.largest),
            camera: self.fly.camera(width, height),
            scene_time_s,
        };
        if let Some(new) = self.driver.maintain(FrameNumber(self.next), stage)? {
            self.follow(new, settings);
        }
        self.resize(screen.size())?;
        self.apply(screen, settings)?;
        self.adapt(step_s)?;
        self.send_edits();
        let camera = self.camera(scene_time_s);
        let (width, _) = self.size();
        if settings.split == Split::Reference {
            match self.draw_reference(&screen.gpu, (camera, &self.scene_at(scene_time_s))) {
                Ok(drawn) => screen.right_half = drawn.map(|picture| (picture, width / 2)),
                Err(error) => {
                    tracing::warn!(%error, "no local reference");
                    self.reference = LocalReference::Off;
                    self.message = Some(format!("no local reference: {error}"));
                    settings.split = Split::Off;
                }
            }
        }
        let drawn = self.driver.draw(FrameNumber(self.next), camera, scene_time_s, screen)?;
        self.next = self.next.wrapping_add(1);
        let (received, round_trip) =
            self.driver.link.as_ref().map_or((Received::default(), None), |link| (link.received(), link.round_trip()));
        self.figures.push(Instant::now(), &drawn, received, round_trip);
        if let Some(file) = &mut self.stats {
            file.write(&drawn)?;
        }
        Ok(drawn)
    }

    /// Lets the exposure follow what the camera sees, unless it was chosen.
    fn adapt(&mut self, step_s: f64) -> Result<(), ClientError> {
        if self.options.settings.exposure.is_some() {
            return Ok(());
        }
        let adapted = self.driver.frames.renderer.adapt(step_s);
        adapted.map_or(Ok(()), |exposure| self.record(&Record::Exposure(exposure.into())))
    }

    /// Goes on in a scene that the driver's renderer is new to. The camera stays.
    fn follow(&mut self, new: NewScene, settings: &mut Settings) {
        let NewScene { url, welcome, scene, camera_paths, .. } = new;
        settings.set_cameras(&scene.cameras);
        self.editing = self.driver.frames.matcher.world.may_edit().then(|| Editing::new(scene));
        if self.followed.is_some() {
            self.stand(&self.path_camera(self.scene_time_s(), self.size()));
        }
        self.scene_cameras = camera_paths;
        let lights = welcome.lights;
        (settings.lights, settings.lights_on) = (lights, all_of(lights));
        let ClientSettings { predict: predictor, tone, .. } = self.options.settings;
        let lights_on = all_of(lights);
        self.applied = Settings { split: Split::Off, predictor, tone, lights, lights_on, ..self.applied.clone() };
        (self.applied.cameras, self.applied.camera) = (settings.cameras.clone(), settings.camera);
        self.view = DebugView::Picture;
        self.reference = LocalReference::Off;
        self.server = Some((url, welcome));
        self.message = Some("the server has another scene".to_owned());
    }

    /// In pixels.
    pub(crate) fn size(&self) -> (u32, u32) {
        self.driver.frames.renderer.size()
    }

    pub(crate) fn has_reference(&self) -> bool {
        matches!(self.reference, LocalReference::Drawing(_))
    }

    /// Returns a message about the server; `None` if there is no problem.
    pub(crate) fn notice(&self) -> Option<String> {
        self.driver.link_state()?.message(Instant::now())
    }

    /// Returns the reference picture once the local server runs.
    fn draw_reference(
        &mut self,
        gpu: &Gpu,
        looked_at: (Camera, &SceneAt),
    ) -> Result<Option<wgpu::Texture>, ClientError> {
        let (size, largest) = (self.size(), largest_mask(self.largest));
        match &mut self.reference {
            LocalReference::Off => {
                let welcome = self.server.as_ref().map(|(_, welcome)| welcome);
                let scene = local_scene(&self.options, welcome)?;
                let digest = welcome.map(|welcome| welcome.scene_digest);
                self.reference = LocalReference::Starting(reference::start(
                    scene,
                    digest,
                    &self.options,
                    largest,
                    self.stop.clone(),
                )?);
                self.message = Some("starting a local server for the reference".to_owned());
                Ok(None)
            }
            LocalReference::Starting(starting) => {
                if let Some(ready) = starting.poll() {
                    let reference = Reference::new(gpu, ready?, size, &self.driver.frames.renderer, largest)?;
                    self.reference = LocalReference::Drawing(Box::new(reference));
                }
                Ok(None)
            }
            LocalReference::Drawing(reference) => {
                let exposure = self.driver.frames.renderer.exposure();
                reference.set_look(exposure, self.applied.tone);
                reference.draw(gpu, size, looked_at, (self.applied.lights_on, self.view)).map(Some)
            }
        }
    }

    /// Leaves the server and finishes all files.
    ///
    /// # Errors
    /// Errors if a file could not be written, or the client had given the server up.
    pub(crate) fn finish(mut self) -> Result<(), ClientError> {
        let given_up = self.driver.link_state().filter(LinkState::is_final).and_then(|state| state.loss());
        let masks = self.driver.leave().link.failure.map_or(Ok(()), Err);
        let recorded = self.driver.recorder.take().map_or(Ok(()), Recorder::finish);
        let counted = self.stats.map_or(Ok(()), StatsFile::finish);
        recorded.and(counted).and(masks)?;
        given_up.filter(|_| self.stop.asked().is_none()).map_or(Ok(()), |loss| Err(ClientError::EndedAlone(loss)))
    }

    /// Adds a record to the recording, if there is one.
    fn record(&mut self, record: &Record) -> Result<(), ClientError> {
        self.driver.recorder.as_mut().map_or(Ok(()), |recorder| recorder.write(record))
    }

    /// Resizes the pictures to the window.
    fn resize(&mut self, screen: (u32, u32)) -> Result<(), ClientError> {
        let size = fitted(screen, self.largest);
        if self.window_size.0 != size {
            self.window_size = (size, Instant::now());
        }
        if size != self.size() && self.window_size.1.elapsed() >= RESIZE_DELAY {
            self.driver.frames.renderer.resize(size)?;
            self.record(&Record::Size([size.0, size.1]))?;
            self.driver.frames.guard = GuardChoice::new(self.applied.guard, size);
            self.set_split(self.applied.split)?;
        }
        Ok(())
    }

    fn set_split(&mut self, split: Split) -> Result<(), ClientError> {
        let unlit_from_px = (split == Split::Unlit).then_some(self.size().0 / 2);
        self.driver.frames.renderer.set_split(unlit_from_px);
        self.record(&Record::Split(unlit_from_px))?;
        if split == Split::Reference {
            // The local server's masks are not recorded.
            let text = "the right half is a local reference, which replays do not draw".to_owned();
            self.record(&Record::Event { frame: self.next, text })?;
        }
        Ok(())
    }

    /// Applies what the person has changed since the last frame.
    fn apply(&mut self, screen: &mut Screen, settings: &Settings) -> Result<(), ClientError> {
        if settings.predictor != self.applied.predictor {
            self.driver.frames.renderer.set_predictor(settings.predictor);
            self.record(&Record::Predictor(settings.predictor))?;
        }
        if settings.quality != self.applied.quality {
            self.driver.frames.renderer.set_quality(settings.quality);
            self.record(&Record::Quality(settings.quality))?;
        }
        if settings.tone != self.applied.tone {
            self.driver.frames.renderer.set_tone(settings.tone);
            self.record(&Record::Tone(settings.tone))?;
        }
        if settings.mode != self.applied.mode {
            self.driver.frames.machine.set_mode(settings.mode);
        }
        if settings.guard != self.applied.guard {
            self.driver.frames.guard = GuardChoice::new(settings.guard, self.size());
        }
        if settings.camera != self.applied.camera
            && let Some(path) = settings.camera.and_then(|index| self.scene_cameras.get(index)).cloned()
        {
            let (width, height) = self.size();
            self.stand(&path.camera(self.scene_time_s(), width, height));
            // One that moves is followed until the person leaves its path.
            if path.follows_scene() {
                (self.followed, self.follows_path) = (Some(path), true);
            }
        }
        if settings.lights_on != self.applied.lights_on {
            self.driver.frames.renderer.set_lights_on(settings.lights_on);
            self.record(&Record::LightsOn(settings.lights_on))?;
        }
        if settings.split != self.applied.split {
            self.set_split(settings.split)?;
        }
        let view = match settings.view {
            DebugView::Age { .. } => DebugView::Age { lags: self.driver.mask_lags() },
            view => view,
        };
        if view != self.view {
            self.view = view;
            self.driver.frames.renderer.set_debug_view(view);
            self.record(&Record::View(view))?;
        }
        screen.set_vsync(settings.vsync);
        self.applied.clone_from(settings);
        Ok(())
    }
}

/// Returns the lights of a scene, one bit each.
fn all_of(lights: u32) -> u32 {
    u32::MAX.checked_shr(32 - lights.min(32)).unwrap_or(0)
}

pub(crate) fn settings(chosen: &ClientSettings) -> Settings {
    Settings {
        predictor: chosen.predict,
        quality: chosen.quality,
        mode: chosen.mode,
        guard: match chosen.guard {
            Guard::Fixed(size) => Guard::Fixed(GuardSize { width: size.width.min(640), height: size.height.min(360) }),
            Guard::Auto => Guard::Auto,
        },
        view: DebugView::Picture,
        split: Split::Off,
        tone: chosen.tone,
        reference: LocalServer::program().is_ok(),
        cameras: Arc::default(),
        camera: None,
        lights: 0,
        lights_on: 0,
        first_digit: 0,
        vsync: chosen.vsync,
        overlay: false,
        help: false,
        edit: false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_fit_the_window_and_the_agreed_size() {
        for (window, largest, picture) in [
            ((1280, 720), (1920, 1080), (1280, 720)),
            ((3840, 2160), (1920, 1080), (1920, 1080)),
            ((800, 2160), (1920, 1080), (400, 1080)),
            ((5, 3), (1920, 1080), (5, 3)),
            ((4000, 1), (1920, 1080), (1920, 1)),
        ] {
            assert_eq!(fitted(window, largest), picture, "{window:?}");
        }
        let (width, height) = fitted((4096, 4096), (4096, 4096));
        assert!(MaskShape::new(width, height, 1).is_ok(), "{width}×{height}");
        let (width, height) = largest_mask((width, height));
        assert!(MaskShape::new(width, height, 32).is_ok(), "{width}×{height}");
    }
}
