//! The local reference: a server on this machine traces exactly the picture in the right half.
//!
//! The server is a child process on loopback with the scene that the client received. The picture waits for its mask,
//! so that both halves show the same moment; a slow machine shows fewer pictures meanwhile. Once started, the server
//! runs until the window closes: an idle session costs nothing.

use std::time::Instant;

use gnomon_client_core::frame::frame_loop::{FrameLoop, MaskSource};
use gnomon_protocol::{
    ids::{FrameNumber, SceneDigest},
    mask::MaskShape,
    message::Welcome,
};
use gnomon_scene::{Scene, SceneAt, camera::Camera};
use gnomon_shaders::gpu::Gpu;

use super::background::Background;
use crate::{
    app::connect::{Connected, get_scene},
    app::local_server::{LocalScene, LocalServer, LocalServerError, temporary_folder},
    error::ClientError,
    frame_driver::{FrameDriver, Shown, Sink},
    guard::{Guard, GuardChoice, GuardSize},
    link::scene_cache::SceneCache,
    mode::ModeMachine,
    options::{HeadlessOptions, Source},
    render::{FrameRenderer, PICTURE_FORMAT, debug_view::DebugView, exposure::Exposure, targets, tone::ToneCurve},
    stop::Stop,
};

/// Returns the file of the scene that the window shows.
///
/// # Errors
/// Errors if the scene is not cached.
pub(super) fn local_scene(
    options: &HeadlessOptions,
    welcome: Option<&Welcome>,
) -> Result<LocalScene, LocalServerError> {
    match (&options.source, welcome) {
        (Source::Offline(scene) | Source::File(scene), _) => Ok(scene.clone()),
        (Source::Server(_), welcome) => {
            let cache = SceneCache::new(options.settings.cache_dir.clone(), options.settings.cache_limit());
            let folder = cache.folder().ok_or(LocalServerError::NoCache)?;
            let file = welcome.and_then(|welcome| cache.cached_file(welcome.scene_digest));
            let file = file.ok_or_else(|| LocalServerError::NotCached(folder.to_owned()))?;
            Ok(LocalScene::new(file))
        }
    }
}

/// A local server and a session with it.
pub(super) struct Ready {
    server: LocalServer,
    scene: Scene,
    connected: Connected,
}

/// Starts the server on a separate thread. Its scene must have `digest`, if given.
///
/// # Errors
/// Errors if the system refuses a thread.
pub(super) fn start(
    scene: LocalScene,
    digest: Option<SceneDigest>,
    options: &HeadlessOptions,
    largest_mask: (u32, u32),
    stop: Stop,
) -> Result<Background<Ready>, ClientError> {
    let options = options.clone();
    Background::spawn("reference", move || prepare(&scene, digest, &options, largest_mask, &stop))
}

fn prepare(
    scene: &LocalScene,
    digest: Option<SceneDigest>,
    options: &HeadlessOptions,
    largest: (u32, u32),
    stop: &Stop,
) -> Result<Ready, ClientError> {
    let server = LocalServer::start(temporary_folder("reference")?, scene)?;
    let mut local = HeadlessOptions::new(Source::Server(server.url().clone()));
    local.settings.cache_dir.clone_from(&options.settings.cache_dir);
    local.settings.cache_limit = options.settings.cache_limit;
    local.settings.wait = true;
    let (scene, connected) = get_scene(&local, largest, stop, |_| (), |_, _| false)?;
    match connected {
        Some(connected) if digest.is_none_or(|digest| digest == connected.welcome().scene_digest) => {
            Ok(Ready { server, scene, connected })
        }
        _ => {
            let reason = "the local server has another scene".to_owned();
            Err(ClientError::Protocol { url: Box::new(server.url().clone()), reason })
        }
    }
}

pub(super) struct Reference {
    driver: FrameDriver,
    target: wgpu::Texture,
    view: wgpu::TextureView,
    next: u32,
    /// The lights and debug view set last.
    applied: (u32, DebugView),
    /// Dropped after its session has ended.
    _server: LocalServer,
}

impl Reference {
    /// Starts the session, for pictures of `size` pixels that look like those of another renderer.
    ///
    /// # Errors
    /// Errors if the adapter has no memory for a second copy of the scene.
    pub(super) fn new(
        gpu: &Gpu,
        ready: Ready,
        size: (u32, u32),
        like: &FrameRenderer,
        largest: (u32, u32),
    ) -> Result<Self, ClientError> {
        let Ready { server, scene, connected } = ready;
        let options = HeadlessOptions::new(Source::Server(server.url().clone()));
        let predictor = options.settings.predict;
        let mut renderer = FrameRenderer::new(gpu, &scene, size, like.exposure(), PICTURE_FORMAT, predictor)?;
        let (environment, survey) = like.environment();
        renderer.set_environment(environment, survey);
        renderer.set_quality(options.settings.quality);
        let lights = connected.welcome().lights;
        let link = connected.start(MaskShape::new(largest.0, largest.1, lights)?, Default::default())?;
        let no_band = Guard::Fixed(GuardSize { width: 0, height: 0 });
        let machine = ModeMachine::new(options.settings.mode, options.settings.thresholds());
        let guard = GuardChoice::new(no_band, size);
        let frames = FrameLoop::new(renderer, machine, guard, MaskSource::Awaited, Instant::now());
        let driver = FrameDriver::new(frames, Some(link), None, u32::MAX);
        let (target, view) = picture(gpu, size);
        Ok(Self { driver, target, view, next: 0, applied: (u32::MAX, DebugView::Picture), _server: server })
    }

    pub(super) fn set_look(&mut self, exposure: Exposure, tone: ToneCurve) {
        self.driver.frames.renderer.set_exposure(exposure);
        self.driver.frames.renderer.set_tone(tone);
    }

    /// Draws the picture of the scene in this state, from `camera`, at `size` pixels. Waits for its mask.
    ///
    /// # Errors
    /// Errors if the server or the adapter fails.
    pub(super) fn draw(
        &mut self,
        gpu: &Gpu,
        size: (u32, u32),
        (camera, scene): (Camera, &SceneAt),
        (lights_on, view): (u32, DebugView),
    ) -> Result<wgpu::Texture, ClientError> {
        if size != self.driver.frames.renderer.size() {
            self.driver.frames.renderer.resize(size)?;
            (self.target, self.view) = picture(gpu, size);
        }
        if self.applied != (lights_on, view) {
            self.applied = (lights_on, view);
            self.driver.frames.renderer.set_lights_on(lights_on);
            self.driver.frames.renderer.set_debug_view(view);
        }
        let frames = &mut self.driver.frames;
        // The local server was started by this client without tokens, so it allows edits.
        let _ = frames.edit(&scene.edits.since(frames.matcher.world.drawn()));
        self.driver.draw(FrameNumber(self.next), camera, scene.time_s, &mut Picture(&self.view))?;
        self.next = self.next.wrapping_add(1);
        Ok(self.target.clone())
    }
}

impl Drop for Reference {
    fn drop(&mut self) {
        self.driver.leave();
    }
}

fn picture(gpu: &Gpu, size: (u32, u32)) -> (wgpu::Texture, wgpu::TextureView) {
    let usage = wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::COPY_SRC;
    let texture = targets::texture(&gpu.device, "reference", size, PICTURE_FORMAT, usage);
    let view = texture.create_view(&wgpu::TextureViewDescriptor::default());
    (texture, view)
}

/// Draws into a texture and reads nothing back.
struct Picture<'a>(&'a wgpu::TextureView);

impl Sink for Picture<'_> {
    fn show(
        &mut self,
        _: FrameNumber,
        renderer: &mut FrameRenderer,
        camera: &Camera,
        visibility_share: f32,
    ) -> Result<Shown, ClientError> {
        renderer.shade(camera, visibility_share, self.0, |_| ())?;
        Ok(Shown::default())
    }
}
