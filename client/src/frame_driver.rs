//! Runs the frame loop on this machine: clock, server link, recording.
//!
//! Shared by headless runs and windows. They differ in their poses, which they pass to [`FrameDriver::draw`], and in
//! what they do with pictures, which is a [`Sink`].

use std::time::{Duration, Instant};

use gnomon_client_core::{
    camera::of_scene,
    frame::{
        frame_loop::{Drawing, FrameLoop, MaskSource},
        stats::{FrameStats, StageTimes},
    },
    mask::pose_history::Rejections,
    render::FrameRenderer,
};
use gnomon_protocol::{ids::FrameNumber, limits::MAX_LAYERS, mask::MaskShape, message::Welcome};
use gnomon_scene::{Scene, camera::Camera};
use gnomon_shaders::gpu::Gpu;

use crate::{
    app::look::Look,
    camera_path::CameraPath,
    config::ClientSettings,
    error::ClientError,
    link::{
        reconnect::OtherScene,
        server_link::{Change, LinkTotals, ServerLink},
        state::LinkState,
        url::ServerUrl,
    },
    occluders::Occluders,
    record::{Record, Recorder},
    render::{PICTURE_FORMAT, exposure::Exposure},
};

pub(crate) trait Sink {
    /// Shades the surfaces that `renderer` drew for `camera` ([`FrameRenderer::shade`]) and shows the picture.
    fn show(
        &mut self,
        frame: FrameNumber,
        renderer: &mut FrameRenderer,
        camera: &Camera,
        visibility_share: f32,
    ) -> Result<Shown, ClientError>;
}

/// Times spent showing a picture.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Shown {
    /// Encoding and submitting the passes.
    pub(crate) shade: Duration,
    /// Waiting for the adapter or the screen.
    pub(crate) readback: Duration,
}

pub(crate) struct FrameDriver {
    pub(crate) frames: FrameLoop,
    pub(crate) link: Option<ServerLink>,
    pub(crate) recorder: Option<Recorder>,
    drawn: u32,
    /// What the last picture shows.
    pub(crate) last: Option<Drawing>,
    /// `u32::MAX` if unknown.
    planned: u32,
    /// Why the server was first lost.
    lost: Option<String>,
    /// Name of the link state that was recorded last.
    recorded_link: Option<&'static str>,
}

/// What a renderer needs when the server comes back with another scene.
#[derive(Clone, Copy)]
pub(crate) struct Stage<'a> {
    pub(crate) gpu: &'a Gpu,
    pub(crate) settings: &'a ClientSettings,
    /// Largest mask to request, in pixels.
    pub(crate) largest_mask: (u32, u32),
    pub(crate) camera: Camera,
    /// In seconds.
    pub(crate) scene_time_s: f64,
}

/// A scene that has replaced another one.
pub(crate) struct NewScene {
    #[cfg_attr(not(feature = "window"), expect(dead_code, reason = "only a window shows it"))]
    pub(crate) url: ServerUrl,
    pub(crate) welcome: Welcome,
    pub(crate) exposure: Exposure,
    #[cfg_attr(not(feature = "window"), expect(dead_code, reason = "only a window shows it"))]
    pub(crate) scene: Scene,
    #[cfg_attr(not(feature = "window"), expect(dead_code, reason = "only a window shows it"))]
    pub(crate) camera_paths: Vec<CameraPath>,
}

#[derive(Debug, Default)]
pub(crate) struct RunTotals {
    pub(crate) link: LinkTotals,
    pub(crate) rejections: Rejections,
    pub(crate) edits_refused: u64,
    /// Why the server was first lost.
    pub(crate) lost: Option<String>,
}

impl FrameDriver {
    /// Draws `planned` frames; `link` is `None` exactly if the loop's masks are [`MaskSource::Offline`].
    pub(crate) fn new(
        mut frames: FrameLoop,
        link: Option<ServerLink>,
        recorder: Option<Recorder>,
        planned: u32,
    ) -> Self {
        if let Some(link) = &link {
            frames.matcher.world.begin(link.terms());
        }
        Self { frames, link, recorder, drawn: 0, last: None, planned, lost: None, recorded_link: None }
    }

    /// Returns the age in frames of the masks used for the last picture, newest first.
    #[cfg_attr(not(feature = "window"), expect(dead_code, reason = "only a window shows it"))]
    pub(crate) fn mask_lags(&self) -> [u32; MAX_LAYERS] {
        self.frames.mask_lags(FrameNumber(self.drawn.saturating_sub(1)))
    }

    pub(crate) fn link_state(&self) -> Option<LinkState> {
        self.link.as_ref().map(ServerLink::state)
    }

    /// Leaves the server and returns the totals.
    pub(crate) fn leave(&mut self) -> RunTotals {
        let link = self.link.take().map(ServerLink::leave).unwrap_or_default();
        let mut rejections = self.frames.matcher.rejections();
        // The receive task drops most early masks before they are decoded.
        rejections.future += link.received.future;
        RunTotals { link, rejections, edits_refused: self.frames.matcher.world.refused(), lost: self.lost.take() }
    }

    /// Looks for a lost server, unless frames wait for their masks. If it has come back with another scene, the
    /// renderer is replaced, and the scene returned. To be called before [`Self::draw`].
    ///
    /// # Errors
    /// Errors if the adapter cannot take the new scene, or a file cannot be written.
    pub(crate) fn maintain(&mut self, frame: FrameNumber, stage: Stage<'_>) -> Result<Option<NewScene>, ClientError> {
        if self.frames.source() == MaskSource::Awaited {
            return Ok(None);
        }
        match self.link.as_mut().map(ServerLink::maintain).transpose()?.flatten() {
            None => Ok(None),
            Some(Change::Reconnected) => {
                self.frames.matcher.reconnected(frame);
                self.begin_world();
                Ok(None)
            }
            Some(Change::OtherScene(other)) => self.change_scene(frame, *other, stage),
        }
    }

    fn change_scene(
        &mut self,
        frame: FrameNumber,
        other: OtherScene,
        stage: Stage<'_>,
    ) -> Result<Option<NewScene>, ClientError> {
        let Some(link) = &mut self.link else { return Ok(None) };
        let Stage { gpu, settings, largest_mask: (width, height), camera, scene_time_s } = stage;
        let OtherScene { pending, scene } = other;
        let (url, welcome) = (pending.url().clone(), pending.welcome.clone());
        let (environment, _) = self.frames.renderer.environment();
        let look = {
            let shown = scene.bare_at(scene_time_s);
            Look::new(environment, &shown, &Occluders::largest_of(&shown), (camera, scene_time_s))
        };
        let size = self.frames.renderer.size();
        let first = look.first_exposure();
        let mut renderer = FrameRenderer::new(gpu, &scene, size, first, PICTURE_FORMAT, settings.predict)?;
        let exposure = look.apply(&mut renderer, settings)?;
        renderer.set_quality(settings.quality);
        match link.start(pending, MaskShape::new(width, height, welcome.lights)?) {
            Ok(()) => {}
            Err(error @ ClientError::Write { .. }) => return Err(error),
            Err(error) => {
                tracing::warn!(%error, "the server is lost again");
                return Ok(None);
            }
        }
        self.frames.change_scene(frame, renderer);
        self.last = None;
        self.begin_world();
        if let Some(mut recorder) = self.recorder.take() {
            let text = format!("the server has the scene {}: the recording ends here", welcome.scene_digest);
            tracing::warn!("{text}");
            recorder.write(&Record::Event { frame: self.drawn.saturating_sub(1), text })?;
            recorder.finish()?;
        }
        let camera_paths = of_scene::paths(&scene);
        Ok(Some(NewScene { url, welcome, exposure, scene, camera_paths }))
    }

    fn begin_world(&mut self) {
        if let Some(link) = &self.link {
            self.frames.matcher.world.begin(link.terms());
        }
    }

    /// Draws frame number `frame` from `camera` at `scene_time_s` into `sink`. Frame numbers ascend.
    pub(crate) fn draw(
        &mut self,
        frame: FrameNumber,
        camera: Camera,
        scene_time_s: f64,
        sink: &mut dyn Sink,
    ) -> Result<FrameStats, ClientError> {
        let begun = Instant::now();
        let mut clock = Clock(begun);
        let mut times = StageTimes::default();
        let waits = self.frames.source() == MaskSource::Awaited;
        let connected = self.link.as_ref().is_some_and(|link| link.ended().is_none());
        if let Some(link) = &mut self.link {
            let world = &mut self.frames.matcher.world;
            if waits { link.settle(world) } else { link.exchange(world, begun) }
        }
        let request = self.frames.request(frame, &camera, scene_time_s, begun, connected);
        if let (Some(link), Some(pose)) = (&self.link, request.pose) {
            link.send_pose(frame, pose);
        }
        if waits {
            // Draws the surfaces while waiting for the mask.
            self.frames.show_requested(frame);
            self.frames.renderer.draw_surfaces(&camera)?;
            times.surfaces = clock.lap();
            if let Some(link) = &mut self.link {
                let (rendered, wanted) = (self.drawn, self.planned);
                let ended = |reason| ClientError::Ended { rendered, wanted, reason };
                link.wait_for(frame, &mut self.frames.matcher, ended)?;
            }
            times.wait = clock.lap();
        }
        let response = self.accept_masks(waits, begun)?;
        times.upload = clock.lap();
        if response.is_some() {
            self.record_masks()?;
            clock.lap();
        }
        let drawing = self.frames.choose(frame, &camera, begun);
        let renderer = &mut self.frames.renderer;
        if !waits {
            renderer.set_time(&drawing.scene);
            renderer.draw_surfaces(&drawing.camera)?;
            times.surfaces = clock.lap();
        }
        let shown = sink.show(frame, renderer, &drawing.camera, drawing.decision.visibility_share)?;
        (times.shade, times.readback) = (shown.shade, shown.readback);

        self.drawn += 1;
        let state = self.link_state();
        let link = state.as_ref().map_or("offline", LinkState::name);
        let stats = self.frames.stats(frame, begun, (&drawing, request.look_ahead_ms, response), &times, link);
        if let Some(recorder) = &mut self.recorder {
            recorder.write(&Record::Frame {
                frame: frame.0,
                requested: (&camera).into(),
                shown: (&drawing.camera).into(),
                scene_time_s: drawing.scene.time_s,
                edits: drawing.scene.edits.as_ref().clone(),
                visibility_share: drawing.decision.visibility_share,
                timing: (&stats).into(),
            })?;
        }
        self.record_link(state)?;
        self.last = Some(drawing);
        Ok(stats)
    }

    /// Takes the masks that have arrived. Returns the newest one's response time if it answers a request. Without its
    /// server, the client keeps drawing with what it has.
    ///
    /// # Errors
    /// If the adapter failed.
    fn accept_masks(&mut self, waits: bool, begun: Instant) -> Result<Option<Duration>, ClientError> {
        let Some(link) = &mut self.link else { return Ok(None) };
        if waits {
            return Ok(self.frames.accept_masks(link.taken_masks(), begun)?);
        }
        let response = self.frames.accept_masks(link.take_masks(), begun)?;
        if let Some(reason) = link.ended().filter(|_| self.lost.is_none() && !link.is_leaving()) {
            tracing::warn!(%reason, "lost the server: drawing without it");
            self.lost = Some(reason);
        }
        Ok(response)
    }

    /// Records the masks that were taken last.
    fn record_masks(&mut self) -> Result<(), ClientError> {
        let (Some(recorder), Some(link)) = (&mut self.recorder, &self.link) else { return Ok(()) };
        for received in link.taken_masks() {
            if let Ok((_, traced_for)) = self.frames.matcher.find(received) {
                recorder.write_mask(received.frame.0, &traced_for, (&received.mask, &received.coverage))?;
            }
        }
        Ok(())
    }

    /// Records a change of the link's state.
    fn record_link(&mut self, state: Option<LinkState>) -> Result<(), ClientError> {
        let (Some(recorder), Some(state)) = (&mut self.recorder, state) else { return Ok(()) };
        let name = state.name();
        if self.recorded_link.replace(name) == Some(name) {
            return Ok(());
        }
        let message = state.message(Instant::now());
        let text = message.map_or_else(|| name.to_owned(), |message| format!("{name}: {message}"));
        recorder.write(&Record::Event { frame: self.drawn - 1, text })
    }
}

struct Clock(Instant);

impl Clock {
    /// Returns the time since the last lap.
    fn lap(&mut self) -> Duration {
        let now = Instant::now();
        let lap = now.duration_since(self.0);
        self.0 = now;
        lap
    }
}
