//! Runs the passes of a frame.

use gnomon_scene::{
    Light, Scene,
    camera::{Camera, Space},
};
use gnomon_shaders::{
    device_failure::DeviceFailure,
    edge_shares::edge_shares,
    gpu::Gpu,
    shading::{Lighting, View},
};

use wgpu::util::DeviceExt as _;

use super::{
    blend::BlendPass,
    debug_view::{DebugPass, DebugView},
    environment::{Environment, Surroundings},
    error::RenderError,
    exposure::Exposure,
    gbuffer::GbufferPass,
    meter::{self, Eye, MeterPass},
    pipeline::{Variable, check_side},
    predict::{MaskView, PredictPass, Seen, depth_history::DepthHistory},
    quality::Quality,
    readback,
    scene_upload::SceneUpload,
    shade::ShadePass,
    stages::StageClock,
    survey::Survey,
    targets::Targets,
    tone::{ToneCurve, TonePass},
};
use crate::{camera::Viewpoint, predictor::Predictor};

/// Height of the pictures that are metered before the first one, in pixels.
const METERED_ROWS: u32 = 90;

/// How often: at the first guess, light may be beyond 16 bits.
const METERED_TIMES: u8 = 2;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PixelVisibility {
    /// Bit k is 1 if light k reaches the pixel.
    pub word: u32,
    /// True if masks gave the visibility of every light. False without a surface, and at a visibility share below 1.
    pub known: bool,
    /// Oldest mask layer that a light needed, 0 the newest; 0 unless `known`.
    pub oldest_layer: u32,
    /// The client's own prediction; 0 at a visibility share of 1.
    pub own: u32,
}

/// Draws frames of one scene at one size.
#[derive(Debug)]
pub struct FrameRenderer {
    pub(super) gpu: Gpu,
    pub(super) space: Space,
    exposure: Exposure,
    pub(super) surroundings: Surroundings,
    eye: Eye,
    /// Whether the eye sees pictures.
    metering: bool,
    pub(super) view: Variable<View>,
    pub(super) scene: SceneUpload,
    pub(super) targets: Targets,
    pub(super) history: DepthHistory,
    pub(super) predict: PredictPass,
    pub(super) gbuffer: GbufferPass,
    pub(super) shade: ShadePass,
    pub(super) blend: BlendPass,
    pub(super) tone: TonePass,
    pub(super) meter: MeterPass,
    debug: DebugPass,
    debug_view: DebugView,
    pub(super) quality: Quality,
    pub(super) draft: bool,
    lighting: Variable<Lighting>,
    pub(super) lights: Vec<Light>,
    /// Bit k is 1 if light k is on.
    lights_on: u32,
    /// First column lit without visibility.
    split_px: Option<u32>,
    /// Visibility share of the last picture.
    visibility_share: f32,
    /// Commands of a mask that the next submission begins with.
    pending: Option<wgpu::CommandEncoder>,
    /// Reads the adapter's clock between stages.
    clock: Option<StageClock>,
    failure: DeviceFailure,
}

impl FrameRenderer {
    /// Uploads `scene` and makes the passes for pictures of this size in pixels. Pictures are drawn into views of
    /// `format`, which must not be an sRGB format: the tone pass encodes.
    ///
    /// # Errors
    /// If the scene or the picture exceeds a limit of the adapter, or the adapter fails.
    pub fn new(
        gpu: &Gpu,
        scene: &Scene,
        (width, height): (u32, u32),
        exposure: Exposure,
        format: wgpu::TextureFormat,
        predictor: Predictor,
    ) -> Result<Self, RenderError> {
        let device = &gpu.device;
        let failure = DeviceFailure::watch(device);
        check_side(device, width.max(height))?;
        // Anisotropic filtering is almost free on a GPU, but in software costs several times the rest of the frame.
        let scene_upload = SceneUpload::new(gpu, scene, if gpu.is_software() { 1 } else { 8 })?;
        let targets = Targets::new(device, (width, height), scene_upload.emits);
        let history = DepthHistory::new(device, width, height);
        let view = Variable::<View>::new(gpu, "view");
        let space = Space::of(scene);
        let lights = scene.lights.clone();
        let lighting = Variable::<Lighting>::new(gpu, "lighting");
        let surroundings = Surroundings::new(gpu, Environment::default(), Survey::default(), &lights);
        let constants = (view.buffer(), lighting.buffer());
        let predict = PredictPass::new(gpu, scene, &scene_upload, &targets, &history, constants, predictor)?;
        let depth_first = !gpu.is_software();
        let gbuffer = GbufferPass::new(gpu, view.buffer(), (&scene_upload, predict.depth_pass()), depth_first)?;
        let edge_shares = device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
            label: Some("edge shares"),
            contents: bytemuck::cast_slice(&edge_shares()),
            usage: wgpu::BufferUsages::STORAGE,
        });
        let shaded_by = (view.buffer(), lighting.buffer(), &edge_shares);
        let shade = ShadePass::new(gpu, shaded_by, &targets, &history, &surroundings, &scene_upload)?;
        let mut blend = BlendPass::new(gpu, shade.layout(), &scene_upload, predict.shadow_map())?;
        blend.set_predictor(&gpu.queue, predictor);
        let tone = TonePass::new(gpu, (view.buffer(), &edge_shares), &targets, &history, format)?;
        let meter = MeterPass::new(gpu, &targets)?;
        let debug = DebugPass::new(gpu, view.buffer(), &targets, &history, format)?;
        let mut renderer = Self {
            gpu: gpu.clone(),
            space,
            exposure,
            surroundings,
            eye: Eye::new(exposure, exposure.ev()),
            metering: false,
            view,
            scene: scene_upload,
            targets,
            history,
            predict,
            gbuffer,
            shade,
            blend,
            tone,
            meter,
            debug,
            debug_view: DebugView::Picture,
            quality: Quality::Low,
            draft: false,
            lighting,
            lights,
            lights_on: u32::MAX,
            split_px: None,
            visibility_share: 1.0,
            pending: None,
            clock: None,
            failure,
        };
        renderer.set_time(0.0);
        renderer.write_lighting();
        renderer.check()?;
        Ok(renderer)
    }

    /// Changes the pictures' size in pixels. Scene and masks stay.
    ///
    /// # Errors
    /// If the picture exceeds a limit of the adapter, or the adapter fails.
    pub fn resize(&mut self, (width, height): (u32, u32)) -> Result<(), RenderError> {
        let device = &self.gpu.device;
        check_side(device, width.max(height))?;
        self.targets = Targets::new(device, (width, height), self.scene.emits);
        self.history = DepthHistory::new(device, width, height);
        self.predict.resize(device, &self.targets, &self.history);
        self.shade.bind(device, &self.targets, &self.history, &self.surroundings);
        self.tone.resize(device, &self.targets, &self.history);
        self.meter.resize(device, &self.targets);
        self.debug.resize(device, &self.targets, &self.history);
        self.check()
    }

    /// Width and height of the pictures, in pixels.
    #[must_use]
    pub fn size(&self) -> (u32, u32) {
        (self.targets.width, self.targets.height)
    }

    /// Sets what pictures show from the next one on.
    pub fn set_debug_view(&mut self, view: DebugView) {
        self.debug_view = view;
    }

    /// Turns light k on if bit k is 1, off otherwise, from the next picture on.
    pub fn set_lights_on(&mut self, lights_on: u32) {
        self.lights_on = lights_on;
        self.write_lighting();
    }

    /// Sets the first column, if any, that is lit without visibility, as if every light reached everything.
    pub fn set_split(&mut self, split_px: Option<u32>) {
        self.split_px = split_px;
        self.write_lighting();
    }

    fn write_lighting(&mut self) {
        let mut lighting = self.exposure.lighting(&self.lights, self.space);
        lighting.lit_from_px = if self.predict.knows_nothing() { 0 } else { self.split_px.unwrap_or(u32::MAX) };
        for (k, light) in lighting.lights.iter_mut().enumerate() {
            if self.lights_on & (1 << k) == 0 {
                light.intensity = glam::Vec3::ZERO;
            }
        }
        self.surroundings.light(&mut lighting, &self.lights, self.lights_on, self.exposure);
        self.lighting.set(&self.gpu.queue, lighting);
    }

    /// Sets the light around and how bright the scene is, from the next picture on.
    pub fn set_environment(&mut self, environment: Environment, survey: Survey) {
        self.surroundings = Surroundings::new(&self.gpu, environment, survey, &self.lights);
        self.shade.bind(&self.gpu.device, &self.targets, &self.history, &self.surroundings);
        self.write_lighting();
    }

    #[must_use]
    pub fn environment(&self) -> (Environment, Survey) {
        (self.surroundings.environment.clone(), self.surroundings.survey())
    }

    /// Sets the tone curve from the next picture on.
    pub fn set_tone(&mut self, curve: ToneCurve) {
        self.tone.set_curve(curve);
    }

    #[must_use]
    pub fn tone(&self) -> ToneCurve {
        self.tone.curve()
    }

    /// Sets the exposure from the next picture on.
    pub fn set_exposure(&mut self, exposure: Exposure) {
        if self.exposure != exposure {
            self.exposure = exposure;
            self.write_lighting();
        }
    }

    /// Sets the exposure that suits what `camera` sees. Draws a few small pictures with the client's
    /// own shadow maps, so it depends on neither masks nor predictor, and waits for them. To be called before the first
    /// picture: masks are forgotten.
    ///
    /// # Errors
    /// If the adapter failed.
    pub fn meter(&mut self, camera: &Camera, predictor: Predictor) -> Result<(), RenderError> {
        let incident = Exposure::for_reference(self.surroundings.survey().lux);
        self.set_exposure(incident);
        // A flat environment is in proportion to the reference, so there is nothing else to find out.
        if !matches!(self.surroundings.environment, Environment::Flat) {
            self.meter_pictures(camera, predictor)?;
        }
        self.eye = Eye::new(self.exposure, incident.ev());
        Ok(())
    }

    fn meter_pictures(&mut self, camera: &Camera, predictor: Predictor) -> Result<(), RenderError> {
        let (size, survey) = (self.size(), self.surroundings.survey());
        let width = u64::from(METERED_ROWS) * u64::from(camera.width) / u64::from(camera.height.max(1));
        self.resize((u32::try_from(width).unwrap_or(u32::MAX).clamp(16, 4 * METERED_ROWS), METERED_ROWS))?;
        self.set_predictor(Predictor::Surface);
        for _ in 0..METERED_TIMES {
            self.draw_surfaces(camera)?;
            let mut encoder = self.light(camera, 1.0);
            self.meter.encode(&self.gpu.device, &mut encoder, self.exposure.ev());
            self.gpu.queue.submit([encoder.finish()]);
            if let Some((histogram, _)) = self.meter.wait(&self.gpu)? {
                let incident = Exposure::for_reference(survey.lux).scale / self.exposure.scale;
                let gain = histogram.gain(incident, self.surroundings.environment.is_painted());
                self.set_exposure(meter::corrected(self.exposure, gain).as_reference());
            }
        }
        self.set_predictor(predictor);
        self.resize(size)
    }

    /// Lets the exposure follow what pictures show, as an eye does, `step_s` seconds after the last call. Returns the
    /// exposure if it changes. Does not wait.
    pub fn adapt(&mut self, step_s: f64) -> Option<Exposure> {
        self.metering = true;
        if let Some((histogram, ev)) = self.meter.take_newest() {
            self.eye.see(&histogram, ev, self.surroundings.environment.is_painted());
        }
        let ev = self.exposure.ev();
        let adapted = self.eye.adapt(ev, step_s);
        (adapted != ev).then(|| {
            self.set_exposure(self.exposure.at_ev(adapted));
            self.exposure
        })
    }

    #[must_use]
    pub fn exposure(&self) -> Exposure {
        self.exposure
    }

    /// Draws the surfaces that `camera` sees, at the renderer's size. Returns on submission, so that the adapter works
    /// while the client waits for the frame's mask.
    ///
    /// # Errors
    /// If the adapter failed.
    pub fn draw_surfaces(&mut self, camera: &Camera) -> Result<(), RenderError> {
        let camera = self.sized(camera);
        self.predict.follow_edits(&self.gpu, &self.scene, (&self.targets, &self.history))?;
        // Surfaces do not depend on the share.
        self.write_view(&camera, self.visibility_share);
        self.history.begin(&self.seen(camera));
        let mut encoder = self.begin();
        self.mark(&mut encoder, "begin");
        self.scene.show_now(&self.gpu.device, &mut encoder);
        self.mark(&mut encoder, "moving");
        let scene = (&self.scene, self.predict.depth_pass());
        self.gbuffer.encode_depth(&mut encoder, self.history.view(), scene);
        self.mark(&mut encoder, "depth");
        self.gbuffer.encode(&mut encoder, (&self.targets, self.history.view()), &self.scene);
        self.mark(&mut encoder, "surfaces");
        self.gpu.queue.submit([encoder.finish()]);
        self.check()
    }

    /// Takes the mask for predicting the next pictures' visibility; the next picture submits its upload. Returns
    /// whether it is used: a mask whose lights are not the scene's, or whose size is not its camera's, clears the
    /// visibility as `None` does.
    ///
    /// # Errors
    /// If a mask of this size exceeds a limit of the adapter.
    pub fn set_mask(&mut self, mask: Option<MaskView<'_>>) -> Result<bool, RenderError> {
        // Writes to buffers come before all commands of a submission, so a second mask would overwrite the first.
        if let Some(first) = self.pending.take() {
            self.gpu.queue.submit([first.finish()]);
        }
        let mut encoder = self.begin();
        let used = self.predict.set_mask(&self.gpu, &mut encoder, mask)?;
        self.mark(&mut encoder, "mask");
        self.pending = Some(encoder);
        Ok(used)
    }

    /// The views that the masks in use were traced for, newest first.
    pub fn mask_views(&self) -> impl Iterator<Item = &Viewpoint> {
        self.predict.mask_views()
    }

    /// Sets how visibility is predicted from the next picture on.
    pub fn set_predictor(&mut self, predictor: Predictor) {
        self.predict.set_predictor(predictor);
        self.blend.set_predictor(&self.gpu.queue, predictor);
    }

    /// Shades the surfaces that [`Self::draw_surfaces`] drew for the same `camera` into `target`, and submits the work
    /// with the commands that `more` adds, such as a copy to the host. `visibility_share`, 0 to 1, weighs visibility
    /// predicted from masks against the client's own prediction.
    ///
    /// # Errors
    /// If the adapter failed.
    pub fn shade(
        &mut self,
        camera: &Camera,
        visibility_share: f32,
        target: &wgpu::TextureView,
        more: impl FnOnce(&mut wgpu::CommandEncoder),
    ) -> Result<wgpu::SubmissionIndex, RenderError> {
        let mut encoder = self.light(camera, visibility_share);
        if self.metering {
            self.meter.encode(&self.gpu.device, &mut encoder, self.exposure.ev());
            self.mark(&mut encoder, "metering");
        }
        match self.debug_view {
            DebugView::Picture => {
                self.tone.encode(&self.gpu, &mut encoder, (&self.targets, &self.history), target)?;
            }
            view => self.debug.encode(&self.gpu, &mut encoder, view, &self.history, target),
        }
        if let Some(clock) = &mut self.clock {
            clock.mark(&mut encoder, "tone");
            clock.finish(&mut encoder);
        }
        more(&mut encoder);
        let submission = self.gpu.queue.submit([encoder.finish()]);
        self.check().map(|()| submission)
    }

    /// Begins a submission with the passes up to the light that reaches the eye.
    fn light(&mut self, camera: &Camera, visibility_share: f32) -> wgpu::CommandEncoder {
        let camera = self.sized(camera);
        self.visibility_share = visibility_share.clamp(0.0, 1.0);
        self.write_view(&camera, self.visibility_share);
        self.write_lighting();
        let mut encoder = self.begin();
        let seen = self.seen(camera);
        let pictures = (&self.targets, &self.history, &mut self.scene);
        let view = (&seen, self.space, self.visibility_share);
        self.predict.encode(&self.gpu, &mut encoder, view, pictures);
        self.mark(&mut encoder, "prediction");
        self.shade.encode(&self.gpu.device, &mut encoder, &self.targets, &self.history, self.visibility_share);
        self.mark(&mut encoder, "shading");
        if !self.draft && self.blend.has_any() {
            if self.predict.by_surface() {
                let seen = Seen::new(&camera, self.space);
                self.predict.need_shadow_map(&self.gpu, &mut encoder, &self.scene, &seen);
            }
            let eye = (camera.position_m - self.space.origin_m).as_vec3();
            let group = self.shade.group(&self.history);
            self.blend.encode(&mut encoder, (&self.targets, self.history.view()), &self.scene, group, eye);
        }
        self.mark(&mut encoder, "blending");
        encoder
    }

    /// Reads the adapter's clock between the stages of the next frames, if its device has [`super::stages::NEEDED`].
    /// Returns whether it does. [`Self::stage_times`] is to be called after each frame.
    pub fn time_stages(&mut self) -> bool {
        self.clock = StageClock::new(&self.gpu);
        self.clock.is_some()
    }

    /// Returns the stages of the last frame and their times in ms. Waits for the adapter: for measurements only.
    ///
    /// # Errors
    /// If the adapter failed.
    pub fn stage_times(&mut self) -> Result<Vec<(&'static str, f64)>, RenderError> {
        self.clock.as_mut().map_or(Ok(Vec::new()), |clock| clock.take(&self.gpu))
    }

    fn mark(&mut self, encoder: &mut wgpu::CommandEncoder, ended: &'static str) {
        if let Some(clock) = &mut self.clock {
            clock.mark(encoder, ended);
        }
    }

    /// Returns the share of pixels whose visibility came from masks (the sky counts), for the newest picture whose
    /// count was read back. Does not wait.
    #[must_use]
    pub fn known_share(&mut self) -> Option<f64> {
        self.predict.known_share()
    }

    /// Reads back the visibility used for the last picture, row by row. Waits for the adapter: for measurements only.
    ///
    /// # Errors
    /// If the adapter failed.
    pub fn read_visibility(&self) -> Result<Vec<PixelVisibility>, RenderError> {
        let words = readback::texels(&self.gpu, &self.targets.visibility, wgpu::TextureAspect::All)?;
        let full_share = self.visibility_share >= 1.0;
        let pixel = |[a, b, c, d, e, f, g, h]: &[u8; 8]| {
            let (word, second) = (u32::from_le_bytes([*a, *b, *c, *d]), u32::from_le_bytes([*e, *f, *g, *h]));
            if full_share {
                // 1 + the oldest layer, or 0 (`predict.wgsl`).
                PixelVisibility { word, known: second != 0, oldest_layer: second.saturating_sub(1), own: 0 }
            } else {
                PixelVisibility { word, known: false, oldest_layer: 0, own: second }
            }
        };
        Ok(words.as_chunks().0.iter().map(pixel).collect())
    }

    fn sized(&self, camera: &Camera) -> Camera {
        Camera { width: self.targets.width, height: self.targets.height, ..*camera }
    }

    /// Begins a submission.
    fn begin(&mut self) -> wgpu::CommandEncoder {
        let begin = || self.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        self.pending.take().unwrap_or_else(begin)
    }

    fn write_view(&mut self, camera: &Camera, visibility_share: f32) {
        let view = View::new(camera, self.space, visibility_share);
        self.view.set(&self.gpu.queue, view);
    }

    fn check(&self) -> Result<(), RenderError> {
        self.failure.get().map_or(Ok(()), |reason| Err(RenderError::Device(reason)))
    }
}
