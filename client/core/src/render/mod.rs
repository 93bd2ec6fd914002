//! The frame renderer: G-buffer → prediction of the visibility → shading with it → blended surfaces → tone mapping.
//!
//! It draws into whatever view it is given and knows nothing of files, windows or the network.

mod blend;
pub mod debug_view;
pub mod exposure;
mod gbuffer;
pub mod predict;
pub mod present;
pub mod readback;
mod scene_upload;
mod shade;
pub mod targets;
#[cfg(any(test, feature = "testing"))]
pub mod testing;
#[cfg(test)]
mod tests;
mod texture;
mod tone;

use gnomon_scene::{Scene, camera::Camera};
use gnomon_shaders::{
    device_failure::DeviceFailure,
    gpu::Gpu,
    shading::{Lighting, View},
    splice::{SpliceError, splice},
};
use thiserror::Error;
use wgpu::util::DeviceExt as _;

use self::{
    blend::BlendPass,
    debug_view::{DebugPass, DebugView},
    exposure::Exposure,
    gbuffer::GbufferPass,
    predict::{MaskView, PredictPass, depth_history::DepthHistory},
    scene_upload::SceneUpload,
    shade::ShadePass,
    targets::Targets,
    tone::TonePass,
};
use crate::predictor::Predictor;

/// What a picture is made of, unless a window wants it otherwise: sRGB-encoded bytes.
pub const PICTURE_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8Unorm;

/// Why a frame cannot be drawn.
#[derive(Debug, Error)]
pub enum RenderError {
    /// The scene or the picture exceeds what the adapter takes.
    #[error("the graphics adapter takes {limit} for {what}, and {needed} are needed")]
    TooLarge {
        /// What is too large.
        what: &'static str,
        /// How large it is, in bytes or pixels.
        needed: u64,
        /// The largest that the adapter takes.
        limit: u64,
    },
    /// The adapter or its driver failed.
    #[error("the graphics adapter failed: {0}")]
    Device(String),
    /// A shader is missing from the program.
    #[error(transparent)]
    Shader(#[from] SpliceError),
}

/// What a pixel was shaded with.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PixelVisibility {
    /// Bit k is 1 when light k reaches the pixel.
    pub word: u32,
    /// Whether the masks said so of every light; the client knew nothing better of some otherwise. Told for a visibility share of 1
    /// only, and false where there is no surface.
    pub known: bool,
    /// What the client alone would say; told for smaller shares only.
    pub own: u32,
}

/// Draws frames of one scene at one size.
#[derive(Debug)]
pub struct FrameRenderer {
    gpu: Gpu,
    origin_m: glam::DVec3,
    exposure: Exposure,
    view: wgpu::Buffer,
    scene: SceneUpload,
    targets: Targets,
    history: DepthHistory,
    predict: PredictPass,
    gbuffer: GbufferPass,
    shade: ShadePass,
    blend: BlendPass,
    tone: TonePass,
    debug: DebugPass,
    debug_view: DebugView,
    lighting: wgpu::Buffer,
    lights: Lighting,
    /// A bit for each light that is on.
    lights_on: u32,
    /// First column in which every light reaches everything, if any does.
    split_px: Option<u32>,
    failure: DeviceFailure,
}

impl FrameRenderer {
    /// Uploads `scene` and makes the passes for pictures of this size. Pictures are drawn into views of `format`, which must
    /// not be an sRGB format: the tone pass encodes.
    ///
    /// # Errors
    /// When the scene or the picture is too large for the adapter, or it fails.
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
        // Anisotropic filtering is nearly free on a GPU and costs several times the rest of the frame in software.
        let scene_upload = SceneUpload::new(device, &gpu.queue, scene, if gpu.is_software() { 1 } else { 8 })?;
        let targets = Targets::new(device, width, height);
        let history = DepthHistory::new(device, width, height);
        let view = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("view"),
            size: size_of::<View>() as u64,
            usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let gbuffer = GbufferPass::new(device, &view, &scene_upload.material_layout)?;
        let lights = exposure.lighting(&scene.lights);
        let lighting = device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
            label: Some("lighting"),
            contents: bytemuck::bytes_of(&lights),
            usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
        });
        let constants = (&view, &lighting);
        let predict = PredictPass::new(gpu, scene, &scene_upload, &targets, &history, constants, predictor)?;
        let shade = ShadePass::new(device, constants, &targets, &history, scene)?;
        let blend = BlendPass::new(device, shade.layout(), &scene_upload)?;
        let tone = TonePass::new(device, &targets, format)?;
        let debug = DebugPass::new(device, &view, &targets, &history, format)?;
        let renderer = Self {
            gpu: gpu.clone(),
            origin_m: scene.origin_m,
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
            failure,
        };
        renderer.check()?;
        Ok(renderer)
    }

    /// Goes on with pictures of another size, in the same scene and with the mask that is there.
    ///
    /// # Errors
    /// When the picture is too large for the adapter, or it fails.
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

    /// What pictures show, from the next one on.
    pub fn set_debug_view(&mut self, view: DebugView) {
        self.debug_view = view;
    }

    /// Which lights shine, a bit each, from the next picture on: the others send nothing, whatever they reach.
    pub fn set_lights_on(&mut self, lights_on: u32) {
        self.lights_on = lights_on;
        self.write_lighting();
    }

    /// From which column on, if any, every light reaches everything: what the picture would be without visibility.
    pub fn set_split(&mut self, split_px: Option<u32>) {
        self.split_px = split_px;
        self.write_lighting();
    }

    fn write_lighting(&self) {
        let mut lights = self.lights;
        lights.lit_from_px = self.split_px.unwrap_or(u32::MAX);
        for (k, light) in lights.lights.iter_mut().enumerate() {
            if self.lights_on & (1 << k) == 0 {
                light.intensity = glam::Vec3::ZERO;
            }
        }
        self.gpu.queue.write_buffer(&self.lighting, 0, bytemuck::bytes_of(&lights));
    }

    /// The exposure that pictures are shown with.
    #[must_use]
    pub fn exposure(&self) -> Exposure {
        self.exposure
    }

    /// Draws the surfaces that `camera` sees, at the renderer's size. Returns as soon as the work is handed over, so
    /// that it goes on while the frame's mask is waited for.
    ///
    /// # Errors
    /// When the adapter failed.
    pub fn draw_surfaces(&mut self, camera: &Camera) -> Result<(), RenderError> {
        let camera = self.sized(camera);
        self.write_view(&camera, 1.0);
        self.history.begin(&camera);
        let mut encoder = self.encoder();
        self.gbuffer.encode(&mut encoder, (&self.targets, self.history.view()), &self.scene);
        self.gpu.queue.submit([encoder.finish()]);
        self.check()
    }

    /// Takes the mask that the next pictures' visibility is predicted from, until another one comes. `None`, or one that
    /// has not the scene's lights or its camera's size, leaves the client to what it knows by itself. Whether the mask is
    /// used is the answer.
    ///
    /// # Errors
    /// When the adapter cannot hold a mask of this size.
    pub fn set_mask(&mut self, mask: Option<MaskView<'_>>) -> Result<bool, RenderError> {
        let mut encoder = self.encoder();
        let used = self.predict.set_mask(&self.gpu, &mut encoder, mask)?;
        self.gpu.queue.submit([encoder.finish()]);
        Ok(used)
    }

    /// What the masks that are carried over were traced for, the newest first.
    pub fn mask_views(&self) -> impl Iterator<Item = &Camera> {
        self.predict.mask_views()
    }

    /// How visibility is carried over from the mask's view, from the next picture on.
    pub fn set_predictor(&mut self, predictor: Predictor) {
        self.predict.predictor = predictor;
    }

    /// Shades the surfaces that [`Self::draw_surfaces`] drew for the same `camera`, into `target`, and hands the work
    /// over together with whatever `more` adds to it (a copy to the host, say). `visibility_share`, from 0 to 1, is how much
    /// the predicted visibility counts against what the client knows by itself.
    ///
    /// # Errors
    /// When the adapter failed.
    pub fn shade(
        &mut self,
        camera: &Camera,
        visibility_share: f32,
        target: &wgpu::TextureView,
        more: impl FnOnce(&mut wgpu::CommandEncoder),
    ) -> Result<wgpu::SubmissionIndex, RenderError> {
        let camera = self.sized(camera);
        self.write_view(&camera, visibility_share.clamp(0.0, 1.0));
        let mut encoder = self.encoder();
        let pictures = (&self.targets, &self.history, &self.scene);
        self.predict.encode(&self.gpu, &mut encoder, (&camera, self.origin_m), pictures);
        self.shade.encode(&mut encoder, &self.targets, &self.history);
        let eye = (camera.position_m - self.origin_m).as_vec3();
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

    /// Share of the picture's pixels whose visibility the mask said something of (the sky counts), in the newest picture
    /// whose count has come back: nothing is waited for.
    #[must_use]
    pub fn known_share(&mut self) -> Option<f64> {
        self.predict.known_share()
    }

    /// The visibility that the last picture was shaded with, row by row. Waits for the adapter: for measuring, not for frames.
    ///
    /// # Errors
    /// When the adapter failed.
    pub fn read_visibility(&self) -> Result<Vec<PixelVisibility>, RenderError> {
        let words = readback::texels(&self.gpu, &self.targets.visibility, wgpu::TextureAspect::All)?;
        let pixel = |[a, b, c, d, e, f, g, h]: &[u8; 8]| {
            let (word, own) = (u32::from_le_bytes([*a, *b, *c, *d]), u32::from_le_bytes([*e, *f, *g, *h]));
            PixelVisibility { word, known: word != own, own }
        };
        Ok(words.as_chunks().0.iter().map(pixel).collect())
    }

    fn sized(&self, camera: &Camera) -> Camera {
        Camera { width: self.targets.width, height: self.targets.height, ..*camera }
    }

    fn encoder(&self) -> wgpu::CommandEncoder {
        self.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default())
    }

    fn write_view(&self, camera: &Camera, visibility_share: f32) {
        let view = View::new(camera, self.origin_m, visibility_share);
        self.gpu.queue.write_buffer(&self.view, 0, bytemuck::bytes_of(&view));
    }

    fn check(&self) -> Result<(), RenderError> {
        self.failure.get().map_or(Ok(()), |reason| Err(RenderError::Device(reason)))
    }
}

fn check_side(device: &wgpu::Device, side: u32) -> Result<(), RenderError> {
    let limit = device.limits().max_texture_dimension_2d;
    if side > limit {
        return Err(RenderError::TooLarge { what: "picture side", needed: side.into(), limit: limit.into() });
    }
    Ok(())
}

/// A uniform buffer's binding, of exactly one `T`.
fn uniform<T>() -> wgpu::BindingType {
    wgpu::BindingType::Buffer {
        ty: wgpu::BufferBindingType::Uniform,
        has_dynamic_offset: false,
        min_binding_size: wgpu::BufferSize::new(size_of::<T>() as u64),
    }
}

/// A uniform buffer that never changes.
fn constant<T: bytemuck::NoUninit>(device: &wgpu::Device, label: &'static str, value: &T) -> wgpu::Buffer {
    device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
        label: Some(label),
        contents: bytemuck::bytes_of(value),
        usage: wgpu::BufferUsages::UNIFORM,
    })
}

/// The shader module of `wgsl/{path}`.
fn shader(device: &wgpu::Device, path: &'static str) -> Result<wgpu::ShaderModule, RenderError> {
    let text = splice(path)?;
    let source = wgpu::ShaderSource::Wgsl(text.into());
    Ok(device.create_shader_module(wgpu::ShaderModuleDescriptor { label: Some(path), source }))
}

/// A pass over the whole picture: one triangle, one target.
fn covering_pipeline(
    device: &wgpu::Device,
    module: &wgpu::ShaderModule,
    layouts: &[&wgpu::BindGroupLayout],
    fragment: &'static str,
    format: wgpu::TextureFormat,
) -> wgpu::RenderPipeline {
    covering_pipeline_with(device, module, layouts, (fragment, &[]), format)
}

/// The same, of a fragment shader whose overrides have these values.
fn covering_pipeline_with(
    device: &wgpu::Device,
    module: &wgpu::ShaderModule,
    layouts: &[&wgpu::BindGroupLayout],
    (fragment, constants): (&'static str, &[(&str, f64)]),
    format: wgpu::TextureFormat,
) -> wgpu::RenderPipeline {
    let groups: Vec<_> = layouts.iter().copied().map(Some).collect();
    let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label: Some(fragment),
        bind_group_layouts: &groups,
        immediate_size: 0,
    });
    device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some(fragment),
        layout: Some(&layout),
        vertex: wgpu::VertexState {
            module,
            entry_point: Some("cover"),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            buffers: &[],
        },
        primitive: wgpu::PrimitiveState::default(),
        depth_stencil: None,
        multisample: wgpu::MultisampleState::default(),
        fragment: Some(wgpu::FragmentState {
            module,
            entry_point: Some(fragment),
            compilation_options: wgpu::PipelineCompilationOptions {
                constants,
                ..wgpu::PipelineCompilationOptions::default()
            },
            targets: &[Some(format.into())],
        }),
        multiview_mask: None,
        cache: None,
    })
}

/// A colour attachment that starts from black or zero.
fn cleared(view: &wgpu::TextureView) -> Option<wgpu::RenderPassColorAttachment<'_>> {
    Some(wgpu::RenderPassColorAttachment {
        view,
        depth_slice: None,
        resolve_target: None,
        ops: wgpu::Operations { load: wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT), store: wgpu::StoreOp::Store },
    })
}
