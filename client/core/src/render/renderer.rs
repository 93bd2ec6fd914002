//! Runs the passes of a frame.

use gnomon_scene::{
    Scene,
    camera::{Camera, Space},
};
use gnomon_shaders::{
    device_failure::DeviceFailure,
    gpu::Gpu,
    shading::{Lighting, View},
};

use super::{
    blend::BlendPass,
    debug_view::{DebugPass, DebugView},
    error::RenderError,
    exposure::Exposure,
    gbuffer::GbufferPass,
    pipeline::{Variable, check_side},
    predict::{MaskView, PredictPass, depth_history::DepthHistory},
    quality::Quality,
    readback,
    scene_upload::SceneUpload,
    shade::ShadePass,
    targets::Targets,
    tone::TonePass,
};
use crate::predictor::Predictor;

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
    gpu: Gpu,
    space: Space,
    exposure: Exposure,
    view: Variable<View>,
    scene: SceneUpload,
    pub(super) targets: Targets,
    pub(super) history: DepthHistory,
    pub(super) predict: PredictPass,
    gbuffer: GbufferPass,
    shade: ShadePass,
    blend: BlendPass,
    tone: TonePass,
    debug: DebugPass,
    debug_view: DebugView,
    lighting: Variable<Lighting>,
    lights: Lighting,
    /// Bit k is 1 if light k is on.
    lights_on: u32,
    /// First column lit without visibility.
    split_px: Option<u32>,
    /// Visibility share of the last picture.
    visibility_share: f32,
    /// Commands of a mask that the next submission begins with.
    pending: Option<wgpu::CommandEncoder>,
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
        let targets = Targets::new(device, width, height);
        let history = DepthHistory::new(device, width, height);
        let view = Variable::<View>::new(gpu, "view");
        let gbuffer = GbufferPass::new(gpu, view.buffer(), &scene_upload)?;
        let space = Space::of(scene);
        let lights = exposure.lighting(&scene.lights, space);
        let mut lighting = Variable::<Lighting>::new(gpu, "lighting");
        lighting.set(&gpu.queue, lights);
        let constants = (view.buffer(), lighting.buffer());
        let predict = PredictPass::new(gpu, scene, &scene_upload, &targets, &history, constants, predictor)?;
        let shade = ShadePass::new(gpu, constants, &targets, &history, &scene_upload)?;
        let mut blend = BlendPass::new(gpu, shade.layout(), &scene_upload, predict.shadow_map())?;
        blend.set_predictor(&gpu.queue, predictor);
        let tone = TonePass::new(gpu, &targets, format)?;
        let debug = DebugPass::new(gpu, view.buffer(), &targets, &history, format)?;
        let renderer = Self {
            gpu: gpu.clone(),
            space,
            exposure,
            view,
            scene: scene_upload,
            targets,
            history,
            predict,
            gbuffer,
            shade,
            blend,
            tone,
            debug,
            debug_view: DebugView::Picture,
            lighting,
            lights,
            lights_on: u32::MAX,
            split_px: None,
            visibility_share: 1.0,
            pending: None,
            failure,
        };
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
        self.targets = Targets::new(device, width, height);
        self.history = DepthHistory::new(device, width, height);
        self.predict.resize(device, &self.targets, &self.history);
        self.shade.resize(device, &self.targets, &self.history);
        self.tone.resize(device, &self.targets);
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

    /// Sets the quality from the next picture on; low at first.
    ///
    /// # Errors
    /// If a shader does not compile.
    pub fn set_quality(&mut self, quality: Quality) -> Result<(), RenderError> {
        self.shade.set_quality(&self.gpu, quality)
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
        let mut lights = self.lights;
        lights.lit_from_px = if self.predict.knows_nothing() { 0 } else { self.split_px.unwrap_or(u32::MAX) };
        for (k, light) in lights.lights.iter_mut().enumerate() {
            if self.lights_on & (1 << k) == 0 {
                light.intensity = glam::Vec3::ZERO;
            }
        }
        self.lighting.set(&self.gpu.queue, lights);
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
        // Surfaces do not depend on the share.
        self.write_view(&camera, self.visibility_share);
        self.history.begin(&camera);
        let mut encoder = self.begin();
        self.gbuffer.encode(&mut encoder, (&self.targets, self.history.view()), &self.scene);
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
        self.pending = Some(encoder);
        Ok(used)
    }

    /// The views that the masks in use were traced for, newest first.
    pub fn mask_views(&self) -> impl Iterator<Item = &Camera> {
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
        let camera = self.sized(camera);
        self.visibility_share = visibility_share.clamp(0.0, 1.0);
        self.write_view(&camera, self.visibility_share);
        self.write_lighting();
        let mut encoder = self.begin();
        let pictures = (&self.targets, &self.history, &self.scene);
        self.predict.encode(&self.gpu, &mut encoder, (&camera, self.space), pictures);
        self.shade.encode(&mut encoder, &self.targets, &self.history);
        let eye = (camera.position_m - self.space.origin_m).as_vec3();
        let group = self.shade.group(&self.history);
        self.blend.encode(&mut encoder, (&self.targets, self.history.view()), &self.scene, group, eye);
        match self.debug_view {
            DebugView::Picture => self.tone.encode(&mut encoder, target),
            view => self.debug.encode(&self.gpu.queue, &mut encoder, view, &self.history, target),
        }
        more(&mut encoder);
        let submission = self.gpu.queue.submit([encoder.finish()]);
        self.check().map(|()| submission)
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
