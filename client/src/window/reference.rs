//! The local reference: the right half of the picture, shaded with what a server on this machine has traced for exactly it.
//!
//! The server is a child on loopback with the scene that the client was sent. The picture waits for its mask, so that both halves are of
//! the same moment; a machine that traces slowly shows fewer pictures meanwhile. Once started it stays until the window closes, and an idle
//! session costs nothing.

use std::{
    sync::mpsc::{Receiver, TryRecvError, sync_channel},
    time::Instant,
};

use gnomon_client_core::frame::frame_loop::{FrameLoop, MaskSource};
use gnomon_protocol::{
    ids::{FrameNumber, SceneDigest},
    mask::MaskShape,
    message::Welcome,
};
use gnomon_scene::{Scene, camera::Camera};
use gnomon_shaders::gpu::Gpu;

use crate::{
    app::connect::{Connected, get_scene},
    app::local_server::{LocalScene, LocalServer, LocalServerError, temporary_folder},
    error::ClientError,
    frame_driver::{FrameDriver, Shown, Sink},
    guard::{Guard, GuardChoice, GuardSize},
    link::scene_cache::SceneCache,
    mode::ModeMachine,
    options::{HeadlessOptions, Source},
    render::{FrameRenderer, PICTURE_FORMAT, debug_view::DebugView, exposure::Exposure, targets},
};

/// The scene that a window shows, for a server on this machine.
///
/// # Errors
/// When the client has no file of it: its cache cannot be written.
pub(super) fn local_scene(
    options: &HeadlessOptions,
    welcome: Option<&Welcome>,
) -> Result<LocalScene, LocalServerError> {
    match (&options.source, welcome) {
        (Source::Offline { scene, lights_from, lights }, _) => {
            Ok(LocalScene { file: scene.clone(), lights_from: lights_from.clone(), lights: *lights })
        }
        (Source::Server(_), welcome) => {
            let cache = SceneCache::new(options.cache_dir.clone());
            let file = welcome.and_then(|welcome| cache.cached_file(welcome.scene_digest));
            let file = file.ok_or_else(|| LocalServerError::NotCached(cache.folder().to_owned()))?;
            Ok(LocalScene { file, lights_from: None, lights: None })
        }
    }
}

/// A reference that is on its way.
pub(super) struct Starting(Receiver<Result<Ready, ClientError>>);

/// A server that listens, and a session with it.
pub(super) struct Ready {
    server: LocalServer,
    scene: Scene,
    connected: Connected,
}

impl Starting {
    /// Starts the server on a thread of its own. `digest` is what its scene must have.
    ///
    /// # Errors
    /// When there can be no thread.
    pub(super) fn begin(
        scene: LocalScene,
        digest: Option<SceneDigest>,
        options: &HeadlessOptions,
        largest: (u32, u32),
    ) -> Result<Self, ClientError> {
        let (send, done) = sync_channel(1);
        let options = options.clone();
        std::thread::Builder::new().name("reference".to_owned()).spawn(move || {
            // A window that has been closed meanwhile wants nothing, and the server goes.
            let _ = send.send(prepare(&scene, digest, &options, largest));
        })?;
        Ok(Self(done))
    }

    /// What came of it, once that is known.
    pub(super) fn take(&self) -> Option<Result<Ready, ClientError>> {
        match self.0.try_recv() {
            Ok(result) => Some(result),
            Err(TryRecvError::Empty) => None,
            Err(TryRecvError::Disconnected) => {
                Some(Err(ClientError::System(std::io::Error::other("the thread of the reference has stopped"))))
            }
        }
    }
}

fn prepare(
    scene: &LocalScene,
    digest: Option<SceneDigest>,
    options: &HeadlessOptions,
    largest: (u32, u32),
) -> Result<Ready, ClientError> {
    let server = LocalServer::start(temporary_folder("reference")?, scene)?;
    let local = HeadlessOptions {
        token: None,
        cache_dir: options.cache_dir.clone(),
        wait: true,
        ..HeadlessOptions::new(Source::Server(server.url().clone()))
    };
    let (scene, connected) = get_scene(&local, largest, |_| ())?;
    match connected {
        Some(connected) if digest.is_none_or(|digest| digest == connected.welcome().scene_digest) => {
            Ok(Ready { server, scene, connected })
        }
        _ => {
            let reason = "it traces another scene than the server".to_owned();
            Err(ClientError::Protocol { url: Box::new(server.url().clone()), reason })
        }
    }
}

/// Draws what the picture should be.
pub(super) struct Reference {
    driver: FrameDriver,
    target: wgpu::Texture,
    view: wgpu::TextureView,
    next: u32,
    /// Lights and debug view, as they were set last.
    shown: (u32, DebugView),
    /// Goes after the session with it.
    _server: LocalServer,
}

impl Reference {
    /// Begins, in pictures of `size` pixels.
    ///
    /// # Errors
    /// When the adapter does not hold the scene twice.
    pub(super) fn new(
        gpu: &Gpu,
        ready: Ready,
        size: (u32, u32),
        exposure: Exposure,
        largest: (u32, u32),
    ) -> Result<Self, ClientError> {
        let Ready { server, scene, connected } = ready;
        let options = HeadlessOptions::new(Source::Server(server.url().clone()));
        let renderer = FrameRenderer::new(gpu, &scene, size, exposure, PICTURE_FORMAT, options.predictor)?;
        let lights = connected.welcome().lights;
        let link = connected.start(MaskShape::new(largest.0, largest.1, lights)?, Default::default())?;
        let no_band = Guard::Fixed(GuardSize { width: 0, height: 0 });
        let machine = ModeMachine::new(options.mode, options.thresholds);
        let guard = GuardChoice::new(no_band, size);
        let frames = FrameLoop::new(renderer, machine, guard, MaskSource::Awaited, Instant::now());
        let driver = FrameDriver::new(frames, Some(link), None, u32::MAX);
        let (target, view) = picture(gpu, size);
        Ok(Self { driver, target, view, next: 0, shown: (u32::MAX, DebugView::Picture), _server: server })
    }

    /// Draws what `camera` sees, in pictures of `size` pixels. Waits for its mask.
    ///
    /// # Errors
    /// When the server or the adapter failed.
    pub(super) fn draw(
        &mut self,
        gpu: &Gpu,
        size: (u32, u32),
        (camera, scene_time_s): (Camera, f64),
        (lights_on, view): (u32, DebugView),
    ) -> Result<wgpu::Texture, ClientError> {
        if size != self.driver.frames.renderer.size() {
            self.driver.frames.renderer.resize(size)?;
            (self.target, self.view) = picture(gpu, size);
        }
        if self.shown != (lights_on, view) {
            self.shown = (lights_on, view);
            self.driver.frames.renderer.set_lights_on(lights_on);
            self.driver.frames.renderer.set_debug_view(view);
        }
        self.driver.draw(FrameNumber(self.next), camera, scene_time_s, &mut Picture(&self.view))?;
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

/// A picture that is only drawn.
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
