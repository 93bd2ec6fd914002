//! The window and its event loop.

use std::{
    path::{Path, PathBuf},
    sync::Arc,
    time::{Duration, Instant},
};

use gnomon_shaders::gpu::GpuOptions;
use winit::{
    application::ApplicationHandler,
    dpi::PhysicalSize,
    event::WindowEvent,
    event_loop::{ActiveEventLoop, ControlFlow, EventLoop},
    window::{Fullscreen, Window, WindowId},
};

use super::{
    editing::Editing,
    gamepad::Gamepad,
    loading::{Loading, Progress},
    overlay,
    play::{self, Play, largest_mask},
    screen::Screen,
};
use crate::{
    app::{connect::Loaded, local_server::LocalScene, servers},
    camera_path::{CameraPath, PathSpec},
    config::ClientSettings,
    error::ClientError,
    input::{Controls, keys::Command},
    options::{HeadlessOptions, Source, WindowOptions},
    stop::{Cause, Stop},
    window::settings::Settings,
};

/// How long a notice stays on the screen.
const NOTICE_TIME: Duration = Duration::from_secs(4);

/// Interval between wake-ups while the window is hidden.
const HIDDEN_INTERVAL: Duration = Duration::from_millis(100);

/// In pixels.
const MIN_SIZE: PhysicalSize<u32> = PhysicalSize::new(160, 90);

/// Runs a window until it is closed, or `stop` is asked.
///
/// # Errors
/// Errors if no window can be opened, the last attempt to show a picture failed, a file could not be written, or the
/// client had given its server up.
pub fn run_window(options: WindowOptions, stop: &Stop) -> Result<(), ClientError> {
    options.run.validate()?;
    let camera_path = options.run.settings.path.as_ref().map(PathSpec::load_file).transpose()?.flatten();
    let event_loop = EventLoop::new().map_err(|error| ClientError::Window(error.to_string()))?;
    let settings = play::settings(&options.run.settings);
    let mut app = App {
        began: Instant::now(),
        camera_path,
        settings,
        controls: Controls::default(),
        control: false,
        gamepad: Gamepad::open(),
        commands: Vec::new(),
        view: None,
        stage: Stage::Closed,
        opening: None,
        notice: None,
        last_frame: None,
        hidden: false,
        largest_px: (0, 0),
        result: Ok(()),
        unsaved: None,
        stop: stop.clone(),
        options,
    };
    event_loop.run_app(&mut app).map_err(|error| ClientError::Window(error.to_string()))?;
    app.close()
}

/// The window and what draws in it.
pub(super) struct View {
    pub(super) window: Arc<Window>,
    pub(super) screen: Screen,
    pub(super) egui: egui_winit::State,
}

enum Stage {
    Closed,
    Loading(Loading),
    Playing(Box<Play>),
    Failed(String),
}

struct Opening {
    source: Source,
    loading: Loading,
}

pub(super) struct App {
    options: WindowOptions,
    began: Instant,
    camera_path: Option<CameraPath>,
    settings: Settings,
    pub(super) controls: Controls,
    /// True while Ctrl is held.
    pub(super) control: bool,
    gamepad: Gamepad,
    /// Commands since the last frame.
    pub(super) commands: Vec<Command>,
    pub(super) view: Option<View>,
    stage: Stage,
    /// A file that was dropped onto the window, while the picture before it goes on.
    opening: Option<Opening>,
    notice: Option<(String, Instant)>,
    last_frame: Option<Instant>,
    /// True if the window is covered or has no area.
    pub(super) hidden: bool,
    /// Largest picture of the session, in pixels.
    largest_px: (u32, u32),
    result: Result<(), ClientError>,
    /// Why the first picture that could not be saved was not.
    unsaved: Option<ClientError>,
    stop: Stop,
}

impl App {
    fn open(&mut self, event_loop: &ActiveEventLoop) -> Result<(), ClientError> {
        let settings = &self.options.run.settings;
        let full_screen = settings.full_screen.then_some(Fullscreen::Borderless(None));
        let attributes = Window::default_attributes()
            .with_title("Gnomon")
            .with_inner_size(PhysicalSize::new(settings.size.width, settings.size.height))
            .with_min_inner_size(MIN_SIZE)
            .with_fullscreen(full_screen);
        let window = event_loop.create_window(attributes).map_err(|error| ClientError::Window(error.to_string()))?;
        let window = Arc::new(window);
        let adapter = GpuOptions {
            adapter: settings.adapter.clone(),
            allow_software: settings.allow_software,
            ..GpuOptions::default()
        };
        let screen = Screen::open(&window, &adapter, settings.vsync)?;
        let context = egui::Context::default();
        overlay::set_style(&context);
        let side = usize::try_from(screen.gpu.device.limits().max_texture_dimension_2d).ok();
        let scale = egui_winit::pixels_per_point(&context, &window);
        let egui = egui_winit::State::new(context, egui::ViewportId::ROOT, &*window, Some(scale), None, side);
        // The server learns the largest mask at the start, and full screen may come later.
        let monitors = event_loop.available_monitors().map(|monitor| monitor.size());
        let largest = monitors
            .chain([window.inner_size()])
            .fold((1, 1), |(width, height): (u32, u32), size| (width.max(size.width), height.max(size.height)));
        self.largest_px = play::fitted(largest, largest);
        self.view = Some(View { window, screen, egui });
        self.load()
    }

    fn load(&mut self) -> Result<(), ClientError> {
        let (options, largest) = (self.options.run.clone(), largest_mask(self.largest_px));
        self.stage = Stage::Loading(Loading::start(options, largest, self.camera_path.clone(), self.stop.clone())?);
        Ok(())
    }

    fn notify(&mut self, text: impl Into<String>) {
        self.notice = Some((text.into(), Instant::now()));
    }

    fn redraw(&mut self, event_loop: &ActiveEventLoop) -> Result<(), ClientError> {
        let Self { gamepad, controls, commands, .. } = self;
        gamepad.poll(&mut controls.sticks, |command| commands.push(command));
        for command in std::mem::take(&mut self.commands) {
            self.execute(command, event_loop);
        }
        if let Stage::Loading(loading) = &self.stage
            && let Some(loaded) = loading.poll()
        {
            self.play(loaded);
        }
        self.show_opened();
        let now = Instant::now();
        let step_s = self.last_frame.replace(now).map_or(0.0, |before| (now - before).as_secs_f64());
        let Some(View { window, screen, egui }) = &mut self.view else { return Ok(()) };
        if let Some(saved) = screen.poll_saved() {
            let text = match &saved {
                Ok(file) => format!("picture: {}", file.display()),
                Err(error) => error.to_string(),
            };
            self.notice = Some((text, now));
            self.unsaved = self.unsaved.take().or(saved.err());
        }
        let retry = {
            let input = egui.take_egui_input(window);
            let context = egui.egui_ctx().clone();
            let mut retry = false;
            let notice = self.notice.as_ref().filter(|(_, since)| now - *since < NOTICE_TIME);
            let (stage, settings) = (&mut self.stage, &mut self.settings);
            if let Stage::Playing(play) = stage {
                play.step(&self.controls.take(step_s, f64::from(screen.size().1)), step_s);
                play.look(settings, screen.size(), context.pixels_per_point());
            }
            let adapter = screen.gpu.info.name.clone();
            let output = context.run_ui(input, |ui| {
                retry = draw_ui(ui.ctx(), stage, settings, &self.options.run.source, notice, &adapter);
            });
            egui.handle_platform_output(window, output.platform_output);
            screen.shapes.textures.append(output.textures_delta);
            screen.shapes.triangles = context.tessellate(output.shapes, output.pixels_per_point);
            screen.shapes.pixels_per_point = output.pixels_per_point;
            retry
        };
        let drawn = match &mut self.stage {
            Stage::Playing(play) => {
                let first = play.figures.now().is_none();
                let drawn = play.frame(screen, &mut self.settings, step_s).map(drop);
                if let Some(text) = play.message.take() {
                    self.notice = Some((text, now));
                }
                if first {
                    tracing::info!(after_ms = self.began.elapsed().as_millis(), "the first picture is shown");
                }
                drawn
            }
            Stage::Closed | Stage::Loading(_) | Stage::Failed(_) => {
                screen.show_overlay();
                Ok(())
            }
        };
        if let Err(error) = drawn {
            self.fail(error);
        }
        if retry {
            self.load()?;
        }
        Ok(())
    }

    /// Begins to open a file that was dropped onto the window. The picture goes on until it is loaded.
    pub(super) fn open_file(&mut self, file: &Path) {
        if let Some(Opening { loading, .. }) = self.opening.take() {
            // Its server ends when it has started.
            drop(loading);
        }
        let source = Source::File(LocalScene::new(file.to_owned()));
        let options = HeadlessOptions { source: source.clone(), ..self.options.run.clone() };
        // A camera path was for the scene before.
        let settings = ClientSettings { path: None, ..options.settings };
        let options = HeadlessOptions { settings, ..options };
        match Loading::start(options, largest_mask(self.largest_px), None, self.stop.clone()) {
            Ok(loading) => {
                self.opening = Some(Opening { source, loading });
                self.notify(format!("opening {}", file.display()));
            }
            Err(error) => self.notify(format!("{}: {error}", file.display())),
        }
    }

    /// Goes on with the scene of a dropped file once it is loaded, or says why it is not.
    fn show_opened(&mut self) {
        let Some(loaded) = self.opening.as_ref().and_then(|opening| opening.loading.poll()) else { return };
        let Some(Opening { source, .. }) = self.opening.take() else { return };
        let loaded = match loaded {
            Ok(loaded) => loaded,
            Err(error) => {
                tracing::warn!(%error, "a dropped file is not shown");
                return self.notify(error.to_string());
            }
        };
        if let Stage::Playing(play) = std::mem::replace(&mut self.stage, Stage::Closed)
            && let Err(error) = play.finish()
        {
            tracing::warn!(%error, "the scene before it");
        }
        let run = &mut self.options.run;
        // Recording and statistics are of the first scene.
        (run.source, run.settings.path, run.record, run.settings.stats) = (source, None, None, None);
        self.camera_path = None;
        self.play(Ok(loaded));
    }

    /// Shows a scene, or why it is not loaded.
    fn play(&mut self, loaded: Result<Loaded, ClientError>) {
        let Some(View { screen, .. }) = &self.view else { return };
        let (options, stop) = (&self.options.run, self.stop.clone());
        let playing =
            loaded.and_then(|loaded| Play::start(screen, loaded, options, self.largest_px, &mut self.settings, stop));
        match playing {
            Ok(play) => {
                tracing::info!(after_ms = self.began.elapsed().as_millis(), "the scene is loaded");
                self.stage = Stage::Playing(Box::new(play));
                self.notify("H: help     O: figures and settings     Tab: camera path");
            }
            Err(error) => self.fail(error),
        }
    }

    /// Shows the error instead of the picture.
    fn fail(&mut self, error: ClientError) {
        tracing::warn!(%error, "no picture");
        if let Stage::Playing(play) = std::mem::replace(&mut self.stage, Stage::Failed(error.to_string())) {
            // The first error tells more.
            let _ = play.finish();
        }
        self.result = Err(error);
    }

    fn execute(&mut self, command: Command, event_loop: &ActiveEventLoop) {
        match command {
            Command::Leave if self.settings.help => self.settings.help = false,
            Command::Leave if self.editing().is_some_and(Editing::cancel) => {}
            Command::Leave if self.settings.edit => self.settings.edit = false,
            Command::Undo => self.editing().into_iter().for_each(Editing::undo),
            Command::Redo => self.editing().into_iter().for_each(Editing::redo),
            Command::Leave => event_loop.exit(),
            Command::FullScreen => {
                if let Some(View { window, .. }) = &self.view {
                    let full = window.fullscreen().is_none().then_some(Fullscreen::Borderless(None));
                    window.set_fullscreen(full);
                }
            }
            Command::Path => {
                if let Stage::Playing(play) = &mut self.stage {
                    play.toggle_path();
                }
            }
            Command::Picture => {
                if let (Stage::Playing(_), Some(View { screen, .. })) = (&self.stage, &mut self.view)
                    && let Some(file) = free_name(self.options.run.settings.out.as_deref().unwrap_or(Path::new("")))
                {
                    screen.save_picture(file);
                }
            }
            command => self.settings.apply(command),
        }
    }

    /// The scene under the person's hand, while it is edited.
    pub(super) fn editing(&mut self) -> Option<&mut Editing> {
        match &mut self.stage {
            Stage::Playing(play) if self.settings.edit => play.editing.as_mut(),
            _ => None,
        }
    }

    /// Tells the editor where the pointer is, in pixels of the window, also while nobody edits. So the first click
    /// after the key that begins editing picks what is under the pointer.
    pub(super) fn pointer_at(&mut self, x: f64, y: f64) {
        if let Stage::Playing(play) = &mut self.stage
            && let Some(editing) = &mut play.editing
        {
            editing.pointer_at(x, y);
        }
    }

    /// Leaves the server. Returns the error that stopped the pictures, or why a file is not written, if any.
    fn close(mut self) -> Result<(), ClientError> {
        tracing::info!(peak_memory_mib = peak_memory_mib(), "leaving");
        let last = self.view.as_mut().and_then(|view| view.screen.finish());
        let unsaved = self.unsaved.take().or(last.and_then(Result::err));
        let ended = match std::mem::replace(&mut self.stage, Stage::Closed) {
            Stage::Playing(play) => play.finish(),
            Stage::Failed(_) | Stage::Closed => std::mem::replace(&mut self.result, Ok(())),
            Stage::Loading(loading) => {
                self.stop.ask(Cause::Closed);
                loading.leave();
                Ok(())
            }
        };
        if let Some(Opening { loading, .. }) = self.opening.take() {
            self.stop.ask(Cause::Closed);
            loading.leave();
        }
        ended.and(unsaved.map_or(Ok(()), Err))
    }
}

/// Returns the peak memory of this process, if the system reports it. A software adapter's memory is included.
fn peak_memory_mib() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    line.split_whitespace().next()?.parse::<u64>().ok().map(|kib| kib / 1024)
}

/// Returns the first free file name in `folder`.
fn free_name(folder: &Path) -> Option<PathBuf> {
    (1..100_000).map(|number| folder.join(format!("gnomon_{number:05}.png"))).find(|file| !file.exists())
}

/// Draws the overlay, or a screen without a picture. Returns whether to try again.
fn draw_ui(
    context: &egui::Context,
    stage: &mut Stage,
    settings: &mut Settings,
    source: &Source,
    notice: Option<&(String, Instant)>,
    adapter: &str,
) -> bool {
    let (server, fingerprint) = match source {
        Source::Server(url) => (url.to_string(), url.certificates.first().map(servers::fingerprint)),
        Source::Offline(local) | Source::File(local) => (local.file.display().to_string(), None),
    };
    match stage {
        Stage::Closed => {}
        Stage::Loading(loading) => {
            let progress = loading.progress();
            if let Progress::FirstVisit { sha256 } = progress {
                if let Some(trusted) = overlay::first_visit(context, &server, &servers::hex(&sha256)) {
                    loading.answer(trusted);
                }
                return false;
            }
            let text = progress.text(Instant::now());
            overlay::loading(context, &server, fingerprint.as_deref(), &text, progress.share());
        }
        Stage::Failed(reason) => return overlay::failure(context, reason),
        Stage::Playing(play) => {
            let notice_of_server = play.notice();
            // The URL has no certificate on a first visit.
            let pinned = play.server.as_ref().and_then(|(url, _)| url.certificates.first());
            let fingerprint = pinned.map(servers::fingerprint);
            let backend = play.server.as_ref().map(|(_, welcome)| welcome.backend.to_string());
            let not_editable = play.not_editable();
            let status = overlay::Status {
                backend: backend.as_deref(),
                adapter,
                server: &server,
                fingerprint: fingerprint.as_deref(),
                picture_px: play.size(),
                speed_m_per_s: play.fly.speed_m_per_s(),
                has_reference: play.has_reference(),
                not_editable: not_editable.as_deref(),
                notice: notice_of_server.as_deref().or(notice.map(|(text, _)| text.as_str())),
            };
            overlay::show(context, settings, &play.figures, &status);
            if let Some(editing) = play.editing.as_mut().filter(|_| settings.edit) {
                overlay::gizmo::show(context, editing);
                overlay::edit_panel::show(context, editing);
            }
        }
    }
    false
}

impl ApplicationHandler for App {
    fn resumed(&mut self, event_loop: &ActiveEventLoop) {
        if self.view.is_none()
            && let Err(error) = self.open(event_loop)
        {
            self.result = Err(error);
            self.stage = Stage::Closed;
            event_loop.exit();
        }
    }

    fn window_event(&mut self, event_loop: &ActiveEventLoop, _: WindowId, event: WindowEvent) {
        if matches!(event, WindowEvent::RedrawRequested) {
            if let Err(error) = self.redraw(event_loop) {
                self.fail(error);
            }
            return;
        }
        if matches!(event, WindowEvent::CloseRequested) {
            event_loop.exit();
            return;
        }
        self.handle_event(&event);
    }

    fn about_to_wait(&mut self, event_loop: &ActiveEventLoop) {
        let late = self.options.exit_after.is_some_and(|after| self.began.elapsed() >= after);
        if late || self.stop.asked().is_some() {
            event_loop.exit();
            return;
        }
        let Some(View { window, .. }) = &self.view else { return };
        // X11 reports covering by an event, but minimising only on request.
        if self.hidden || window.is_minimized() == Some(true) {
            event_loop.set_control_flow(ControlFlow::WaitUntil(Instant::now() + HIDDEN_INTERVAL));
        } else {
            event_loop.set_control_flow(ControlFlow::Poll);
            window.request_redraw();
        }
    }
}
