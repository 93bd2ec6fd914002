//! A scene that is walked through: poses out, masks in, pictures into whatever view the page gives.

mod walk;

use std::{collections::VecDeque, time::Duration};

use gnomon_client_core::{
    camera::{default_path::default_path, of_scene, path::CameraPath},
    frame::{
        frame_loop::{FrameLoop, MaskSource},
        guard::{Guard, GuardChoice},
        mode::{ModeMachine, Thresholds},
        stats::{FrameStats, StageTimes},
    },
    input::fly::{Fly, Motion},
    mask::{
        queue::MaskQueue,
        received::ReceivedMask,
        world::{News, Terms},
    },
    occluders::Occluders,
    render::{FrameRenderer, RenderError, debug_view::DebugView},
};
use gnomon_protocol::{
    ids::{FrameNumber, SceneDigest},
    limits::MAX_LAYERS,
    mask::MaskShape,
    receive::ReceiverCounters,
};
use gnomon_scene::{Scene, camera::Camera};
use gnomon_shaders::gpu::Gpu;
use web_time::Instant;

use crate::{
    options::{Options, Settings},
    reception::Reception,
    renderer::light,
    view,
};

/// Time to cross the scene at the initial speed.
const CROSSING_S: f64 = 12.0;

/// Most initial speed: a drive. Farther is for the wheel.
const MOST_INITIAL_SPEED_M_PER_S: f64 = 20.0;

/// Frames in which eyes are still closed: the exposure jumps to what suits the first pictures.
const DAZZLED_FRAMES: u32 = 12;

/// Longer than any eye needs.
const LONG_S: f64 = 1e6;

/// A pose whose mask is awaited is sent again after this time.
const PATIENCE: Duration = Duration::from_millis(500);

/// How long the first picture waits for its mask, and then goes without.
const FIRST_PATIENCE: Duration = Duration::from_secs(2);

/// What a frame has left behind.
#[derive(Debug)]
pub struct Drawn {
    pub stats: FrameStats,
    /// Of a walk: the frame, and the digest of the mask that it was drawn with.
    pub walked: Option<(u32, String)>,
    /// True if the walk ends with it.
    pub arrived: bool,
}

#[derive(Debug)]
pub struct Play {
    gpu: Gpu,
    frames: FrameLoop,
    reception: Option<Reception>,
    queue: MaskQueue,
    /// The masks taken last, oldest first.
    front: VecDeque<ReceivedMask>,
    digest: SceneDigest,
    lights: u32,
    next: u32,
    drawn: u32,
    fly: Fly,
    camera_path: CameraPath,
    /// Of the scene's file.
    cameras: Vec<CameraPath>,
    camera: Option<usize>,
    /// The one of them that is followed instead of the path.
    followed: Option<CameraPath>,
    follows_path: bool,
    path_s: f64,
    options: Options,
    applied: Settings,
    shown_view: DebugView,
    /// When the awaited pose was sent last.
    awaited_since: Option<Instant>,
    /// Until the first picture is drawn: when it began to wait for its mask.
    first_since: Option<Instant>,
    /// True while pictures are drafts.
    is_draft: bool,
}

impl Play {
    /// Prepares to draw pictures of this size, with what [`crate::renderer::new_renderer`] made for the scene.
    ///
    /// # Errors
    /// If the picture exceeds a limit of the adapter, or the adapter fails.
    pub fn new(
        gpu: &Gpu,
        mut renderer: FrameRenderer,
        (scene, digest): (&Scene, SceneDigest),
        size: (u32, u32),
        options: &Options,
        now: Instant,
    ) -> Result<Self, RenderError> {
        let path = of_scene::path_of(scene, None).unwrap_or_else(|_| {
            let shown = scene.bare_at(0.0);
            default_path(&shown, &Occluders::largest_of(&shown))
        });
        let path = options.walk.as_ref().map_or(path, |walk| walk.path.clone());
        let linked = options.view.as_deref().and_then(|text| view::read(text, size.0, size.1));
        let first = linked.unwrap_or_else(|| path.camera(0.0, size.0, size.1));
        if renderer.size() != size {
            renderer.resize(size)?;
        }
        let settings = Settings::default();
        let source = match options.walk {
            Some(_) => MaskSource::Awaited,
            None => MaskSource::Streamed { look_ahead: !gpu.is_software() },
        };
        let machine = ModeMachine::new(settings.mode, Thresholds::default());
        let guard = GuardChoice::new(Guard::default(), size);
        let extent_m = f64::from((scene.bounds.max - scene.bounds.min).length());
        let speed = (extent_m / CROSSING_S).min(MOST_INITIAL_SPEED_M_PER_S);
        Ok(Self {
            gpu: gpu.clone(),
            frames: FrameLoop::new(renderer, machine, guard, source, now),
            reception: None,
            queue: MaskQueue::default(),
            front: VecDeque::new(),
            digest,
            lights: lights_of(scene),
            next: 0,
            drawn: 0,
            fly: Fly::from_camera(&first, speed),
            camera_path: path,
            cameras: of_scene::paths(scene),
            camera: None,
            followed: None,
            follows_path: false,
            path_s: 0.0,
            options: options.clone(),
            applied: settings,
            shown_view: DebugView::Picture,
            awaited_since: None,
            first_since: Some(now),
            is_draft: options.walk.is_none(),
        })
    }

    /// The scene that is drawn.
    #[must_use]
    pub fn digest(&self) -> SceneDigest {
        self.digest
    }

    /// Goes on in another scene, with what [`crate::renderer::new_renderer`] made for it. The camera stays.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn change_scene(
        &mut self,
        mut renderer: FrameRenderer,
        (scene, digest): (&Scene, SceneDigest),
        now: Instant,
    ) -> Result<(), RenderError> {
        let (width, height) = self.size();
        if renderer.size() != (width, height) {
            renderer.resize((width, height))?;
        }
        if self.followed.is_some() {
            self.stand(&self.path_camera(now));
        }
        self.frames.change_scene(FrameNumber(self.next), renderer);
        (self.digest, self.lights, self.drawn) = (digest, lights_of(scene), 0);
        (self.cameras, self.camera) = (of_scene::paths(scene), None);
        self.front.clear();
        self.shown_view = DebugView::Picture;
        (self.first_since, self.is_draft) = (Some(now), self.options.walk.is_none());
        let settings = std::mem::take(&mut self.applied);
        self.apply(&settings)
    }

    /// Finds out how light it is, and what the sky looks like. Call before the scene's first picture.
    pub fn light(&mut self, scene: &Scene, now: Instant) {
        let (camera, scene_time_s) = (self.camera_now(now), self.scene_time_s(now));
        let shown = scene.bare_at(scene_time_s);
        let occluders = Occluders::largest_of(&shown);
        light(&mut self.frames.renderer, &shown, &occluders, (&camera, scene_time_s), self.options.exposure);
    }

    /// Poses go over a new connection from now on, for masks of at most this size.
    ///
    /// # Errors
    /// If the size is beyond the protocol's limits.
    pub fn connected(&mut self, (width, height): (u32, u32), terms: Terms, now: Instant) -> Result<(), RenderError> {
        let shape =
            MaskShape::new(width, height, self.lights).map_err(|error| RenderError::Device(error.to_string()))?;
        self.reception = Some(Reception::new(shape, now));
        self.queue = MaskQueue::default();
        self.frames.matcher.reconnected(FrameNumber(self.next));
        self.frames.matcher.world.begin(terms);
        self.awaited_since = None;
        if self.first_since.is_some() && self.options.walk.is_none() {
            self.first_since = Some(now);
            self.ask_first(now);
        }
        Ok(())
    }

    /// Takes what the server says of its scene.
    pub fn hear(&mut self, news: &News, now: Instant) {
        // Half of the way to the server is not known here: a shared clock is as late.
        self.frames.matcher.world.hear(news, Duration::ZERO, now);
    }

    /// Sends the first picture's pose.
    fn ask_first(&mut self, now: Instant) {
        let (frame, camera) = (FrameNumber(self.next), self.camera_now(now));
        let request = self.frames.request(frame, &camera, self.scene_time_s(now), now, true);
        if let (Some(reception), Some(pose)) = (&mut self.reception, &request.pose) {
            reception.send_pose(frame, pose);
        }
        self.awaited_since = Some(now);
    }

    /// Returns whether the first picture had better wait for its mask. A mask that is late is asked for again.
    fn awaits_first(&mut self, now: Instant) -> bool {
        let Some(since) = self.first_since else { return false };
        if self.has_mask_of(self.next) || now.saturating_duration_since(since) > FIRST_PATIENCE {
            return false;
        }
        if self.awaited_since.is_some_and(|sent| now.saturating_duration_since(sent) > PATIENCE) {
            self.ask_again(now);
        }
        true
    }

    /// Sends the pose of the next frame again. It is the same: a mask that is under way answers it, too.
    fn ask_again(&mut self, now: Instant) {
        let frame = FrameNumber(self.next);
        if let (Some(reception), Some(request)) = (&mut self.reception, self.frames.matcher.request(frame)) {
            reception.send_pose_again(frame, &request.pose);
        }
        self.awaited_since = Some(now);
    }

    /// Returns whether pictures are still drafts, which lack what takes long to compile.
    #[must_use]
    pub fn is_draft(&self) -> bool {
        self.is_draft
    }

    /// Ends the drafts, once one is drawn. Returns whether it does: then pipelines are on their way.
    pub fn end_draft(&mut self) -> bool {
        let ends = self.is_draft && self.first_since.is_none();
        if ends {
            self.is_draft = false;
            self.frames.renderer.set_draft(false);
            self.frames.renderer.compile();
        }
        ends
    }

    /// There is no connection: pictures go on without masks.
    pub fn lost(&mut self) {
        self.reception = None;
    }

    pub fn datagram(&mut self, datagram: &[u8], now: Instant) {
        if let Some(reception) = &mut self.reception {
            reception.push(datagram, now, &mut self.queue);
        }
    }

    pub fn take_outgoing(&mut self) -> Option<Vec<u8>> {
        self.reception.as_mut()?.take_outgoing()
    }

    #[must_use]
    pub fn received(&self) -> ReceiverCounters {
        self.reception.as_ref().map(Reception::counters).unwrap_or_default()
    }

    /// In pixels.
    #[must_use]
    pub fn size(&self) -> (u32, u32) {
        self.frames.renderer.size()
    }

    /// # Errors
    /// As [`FrameRenderer::resize`].
    pub fn resize(&mut self, size: (u32, u32)) -> Result<(), RenderError> {
        self.frames.renderer.resize(size)?;
        self.frames.guard = GuardChoice::new(Guard::default(), size);
        self.split(self.applied.split);
        Ok(())
    }

    fn split(&mut self, split: bool) {
        let half = self.size().0 / 2;
        self.frames.renderer.set_split(split.then_some(half));
    }

    /// Applies what the person has changed.
    ///
    /// # Errors
    /// If a shader does not compile.
    pub fn apply(&mut self, settings: &Settings) -> Result<(), RenderError> {
        let before = std::mem::replace(&mut self.applied, settings.clone());
        if before.predictor != settings.predictor {
            self.frames.renderer.set_predictor(settings.predictor);
        }
        if before.quality != settings.quality {
            self.frames.renderer.set_quality(settings.quality);
        }
        if before.tone != settings.tone {
            self.frames.renderer.set_tone(settings.tone);
        }
        if before.mode != settings.mode {
            self.frames.machine.set_mode(settings.mode);
        }
        self.split(settings.split);
        Ok(())
    }

    /// Switches between the camera path and the person, who goes on from there.
    pub fn toggle_path(&mut self, now: Instant) {
        if self.follows_path {
            self.stand(&self.path_camera(now));
        } else {
            self.follows_path = true;
        }
    }

    /// Time of the scene, in seconds.
    fn scene_time_s(&self, now: Instant) -> f64 {
        now.saturating_duration_since(self.frames.started()).as_secs_f64()
    }

    fn path_camera(&self, now: Instant) -> Camera {
        let (width, height) = self.size();
        let path = self.followed.as_ref().unwrap_or(&self.camera_path);
        let time_s = if path.follows_scene() { self.scene_time_s(now) } else { self.path_s };
        path.camera(time_s, width, height)
    }

    /// Goes to the next camera of the scene's file.
    pub fn next_camera(&mut self, now: Instant) {
        let next = self.camera.map_or(0, |camera| (camera + 1) % self.cameras.len().max(1));
        if let Some(path) = self.cameras.get(next).cloned() {
            self.stand(&path.camera(self.scene_time_s(now), 1, 1));
            self.camera = Some(next);
            // One that moves is followed until the person leaves its path.
            if path.follows_scene() {
                (self.followed, self.follows_path) = (Some(path), true);
            }
        }
    }

    /// Goes where a link says. Returns whether it is a view.
    pub fn go(&mut self, text: &str) -> bool {
        let camera = view::read(text, 1, 1);
        if let Some(camera) = &camera {
            self.stand(camera);
        }
        camera.is_some()
    }

    fn stand(&mut self, camera: &Camera) {
        self.fly = Fly::from_camera(camera, self.fly.speed_m_per_s());
        (self.followed, self.follows_path) = (None, false);
    }

    /// Where the camera is, as a link has it.
    #[must_use]
    pub fn view(&self, now: Instant) -> String {
        view::written(&self.camera_now(now))
    }

    fn camera_now(&self, now: Instant) -> Camera {
        let (width, height) = self.size();
        match &self.options.walk {
            Some(walk) => walk.path.camera(walk.time_s(self.next), width, height),
            None if self.follows_path => self.path_camera(now),
            None => self.fly.camera(width, height),
        }
    }

    /// Draws the next frame, `step_s` seconds after the last, into `target`. `None` while a frame awaits its mask.
    ///
    /// # Errors
    /// If the adapter failed.
    pub fn frame(
        &mut self,
        motion: &Motion,
        step_s: f64,
        now: Instant,
        target: impl FnOnce(&mut FrameRenderer, &Camera, f32) -> Result<(), RenderError>,
    ) -> Result<Option<Drawn>, RenderError> {
        if let Some(reception) = &mut self.reception {
            reception.poll_deadline(now, &mut self.queue);
        }
        if self.options.walk.is_some() {
            return self.walk(now, target);
        }
        if self.awaits_first(now) {
            return Ok(None);
        }
        let first = self.first_since.take().is_some();
        if self.follows_path {
            self.path_s += step_s;
        } else if !first {
            self.fly.step(motion, step_s);
        }
        if self.options.exposure.is_none() && !self.is_draft {
            let dazzled = self.drawn < DAZZLED_FRAMES;
            let _ = self.frames.renderer.adapt(if dazzled { LONG_S } else { step_s });
        }
        let (frame, camera) = (FrameNumber(self.next), self.camera_now(now));
        let connected = self.reception.is_some();
        let mut look_ahead_ms = 0;
        if self.awaited_since.take().is_none() {
            let request = self.frames.request(frame, &camera, self.scene_time_s(now), now, connected);
            if let (Some(reception), Some(pose)) = (&mut self.reception, &request.pose) {
                reception.send_pose(frame, pose);
            }
            look_ahead_ms = request.look_ahead_ms;
        }
        let fresh = self.queue.take(&mut self.front) || first;
        let response = self.frames.accept_masks(self.front.iter().filter(|_| fresh), now)?;
        if first && self.frames.matcher.current().is_some() {
            self.frames.machine.skip_fade();
        }
        let drawing = self.frames.choose(frame, &camera, now);
        let view = match self.applied.view {
            DebugView::Age { .. } => DebugView::Age { lags: self.lags() },
            view => view,
        };
        if std::mem::replace(&mut self.shown_view, view) != view {
            self.frames.renderer.set_debug_view(view);
        }
        self.frames.renderer.set_time(&drawing.scene);
        self.frames.renderer.draw_surfaces(&drawing.camera)?;
        target(&mut self.frames.renderer, &drawing.camera, drawing.decision.visibility_share)?;
        let link = if connected { "live" } else { "lost" };
        let outcome = (&drawing, look_ahead_ms, response);
        let stats = self.frames.stats(frame, now, outcome, &StageTimes::default(), link);
        self.next = self.next.wrapping_add(1);
        self.drawn = self.drawn.saturating_add(1);
        Ok(Some(Drawn { stats, walked: None, arrived: false }))
    }

    fn lags(&self) -> [u32; MAX_LAYERS] {
        self.frames.mask_lags(FrameNumber(self.next.saturating_sub(1)))
    }

    /// Returns whether the whole mask of this frame has come.
    pub fn has_mask_of(&mut self, frame: u32) -> bool {
        self.queue.take(&mut self.front);
        self.front.back().is_some_and(|mask| mask.frame == FrameNumber(frame) && mask.coverage.is_whole())
    }
}

fn lights_of(scene: &Scene) -> u32 {
    u32::try_from(scene.lights.len()).unwrap_or(u32::MAX)
}
