//! The prediction pass: from a mask that was traced for another view to the visibility of every pixel of this one.
//!
//! [`mask_words`] turns the received bit planes into a word a pixel, [`depth_history`] tells what the mask's view saw, or
//! [`depth_pass`] draws it anew, [`shadow_map`] fills in what it did not see, and [`known`] counts how much that was. The shading
//! passes read the result: two words a pixel (`wgsl/shading/predict.wgsl`).

pub(crate) mod depth_history;
pub(crate) mod depth_pass;
mod known;
mod mask_words;
pub(crate) mod shadow_map;
#[cfg(test)]
mod tests;

use glam::DVec3;
use gnomon_protocol::mask::{Mask, MaskShape};
use gnomon_shaders::{
    camera::Camera,
    gpu::Gpu,
    scene::Scene,
    shading::{Lighting, Prediction, View},
};

use self::{
    depth_history::DepthHistory,
    depth_pass::{DepthPass, Faces},
    known::UnknownCount,
    mask_words::{MaskWords, WordsPass},
    shadow_map::ShadowMap,
};
use super::{
    RenderError, cleared, covering_pipeline,
    scene_upload::SceneUpload,
    shader,
    targets::{DEPTH, Targets, VISIBILITY, texture},
    uniform,
};
use crate::predictor::{Predictor, Unknown};

/// A mask, and the view that it was traced for.
#[derive(Debug, Clone, Copy)]
pub struct MaskView<'a> {
    /// The mask.
    pub mask: &'a Mask,
    /// The camera that it was traced for, with the mask's own width, height and field of view.
    pub traced_for: &'a Camera,
}

/// The pass and everything that it remembers.
#[derive(Debug)]
pub(crate) struct PredictPass {
    pub(crate) predictor: Predictor,
    pipeline: wgpu::RenderPipeline,
    scene_group: wgpu::BindGroup,
    surface_layout: wgpu::BindGroupLayout,
    mask_layout: wgpu::BindGroupLayout,
    /// The picture's own surfaces, by the place of its depth in the history.
    surface_groups: Vec<wgpu::BindGroup>,
    /// Takes samples as they are.
    nearest: wgpu::Sampler,
    uniform: wgpu::Buffer,
    depth_pass: DepthPass,
    words_pass: WordsPass,
    unknown: UnknownCount,
    lights: u32,
    pixels: u32,
    words: MaskWords,
    /// The view of the mask in `words`, when there is one.
    traced_for: Option<Camera>,
    /// Where the depth of that view is, once it was needed.
    depth: Option<MaskDepth>,
    /// Memory for depth that is drawn anew.
    drawn: Option<wgpu::TextureView>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum MaskDepth {
    /// Place in the history.
    Kept(usize),
    /// It was drawn anew.
    Drawn,
}

/// What the shader is told of the mask. Twin of the constants in `predict.wgsl`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Source {
    None = 0,
    SameView = 1,
    OtherView = 2,
}

impl PredictPass {
    pub(crate) fn new(
        gpu: &Gpu,
        scene: &Scene,
        upload: &SceneUpload,
        targets: &Targets,
        history: &DepthHistory,
        (view, lighting): (&wgpu::Buffer, &wgpu::Buffer),
        predictor: Predictor,
    ) -> Result<Self, RenderError> {
        let device = &gpu.device;
        let depth_pass = DepthPass::new(device, upload)?;
        let shadow_map = ShadowMap::new(device, &gpu.queue, scene, upload, &depth_pass);
        let unknown = UnknownCount::new(device);
        let uniform = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("prediction"),
            size: size_of::<Prediction>() as u64,
            usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let [scene_layout, surface_layout, mask_layout] = layouts(device);
        let picture = wgpu::BindingResource::TextureView;
        let scene_group = group(
            device,
            &scene_layout,
            &[
                view.as_entire_binding(),
                lighting.as_entire_binding(),
                picture(&shadow_map.texture),
                shadow_map.views.as_entire_binding(),
                uniform.as_entire_binding(),
                unknown.binding(),
            ],
        );
        let surface_groups = surface_groups(device, &surface_layout, targets, history);
        let module = shader(device, "shading/predict.wgsl")?;
        let layouts = [&scene_layout, &surface_layout, &mask_layout];
        let pipeline = covering_pipeline(device, &module, &layouts, "predict", VISIBILITY);
        let words_pass = WordsPass::new(device)?;
        let lights = u32::try_from(scene.lights.len()).unwrap_or(u32::MAX);
        // A picture without a mask still binds one.
        let smallest =
            MaskShape::new(1, 1, lights.clamp(1, 32)).map_err(|error| RenderError::Device(error.to_string()))?;
        let words = words_pass.memory(device, smallest)?;
        Ok(Self {
            predictor,
            pipeline,
            scene_group,
            surface_layout,
            mask_layout,
            surface_groups,
            nearest: device.create_sampler(&wgpu::SamplerDescriptor::default()),
            uniform,
            depth_pass,
            words_pass,
            unknown,
            lights,
            pixels: targets.width * targets.height,
            words,
            traced_for: None,
            depth: None,
            drawn: None,
        })
    }

    /// Goes on with pictures of another size. The mask stays: it is carried over.
    pub(crate) fn resize(&mut self, device: &wgpu::Device, targets: &Targets, history: &DepthHistory) {
        self.surface_groups = surface_groups(device, &self.surface_layout, targets, history);
        self.pixels = targets.width * targets.height;
        // What the history held is gone.
        self.depth = self.depth.filter(|depth| *depth == MaskDepth::Drawn);
    }

    /// Takes another mask, or none. Whether it can be used is the answer: its lights must be the scene's, and its size the
    /// camera's.
    ///
    /// # Errors
    /// When the adapter cannot hold a mask of this size.
    pub(crate) fn set_mask(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        view: Option<MaskView<'_>>,
    ) -> Result<bool, RenderError> {
        let fits = |view: &MaskView<'_>| {
            let shape = view.mask.shape();
            (shape.width(), shape.height(), shape.lights())
                == (view.traced_for.width, view.traced_for.height, self.lights)
        };
        self.depth = None;
        self.traced_for = view.filter(fits).map(|view| *view.traced_for);
        let Some(MaskView { mask, .. }) = view.filter(fits) else { return Ok(false) };
        if self.words.shape() != mask.shape() {
            self.words = self.words_pass.memory(&gpu.device, mask.shape())?;
        }
        self.words.write(&self.words_pass, &gpu.queue, encoder, mask);
        Ok(true)
    }

    /// The view of the mask, when there is one.
    pub(crate) fn traced_for(&self) -> Option<Camera> {
        self.traced_for
    }

    /// The picture in the history that the mask refers to, which must not be drawn over.
    pub(crate) fn kept(&self) -> Option<usize> {
        match self.depth {
            Some(MaskDepth::Kept(place)) => Some(place),
            Some(MaskDepth::Drawn) | None => None,
        }
    }

    /// Predicts into the visibility picture. The G-buffer holds what `camera` sees.
    pub(crate) fn encode(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        (camera, origin_m): (&Camera, DVec3),
        (targets, history, upload): (&Targets, &DepthHistory, &SceneUpload),
    ) {
        let source = self.source(camera);
        let traced_for = self.traced_for.unwrap_or(*camera);
        let (predictor, unknown) = match self.predictor {
            Predictor::None => (0, 0),
            Predictor::Dissertation(unknown) => (
                1,
                match unknown {
                    Unknown::Lit => 0,
                    Unknown::Shadow => 1,
                    Unknown::Copy => 2,
                },
            ),
            Predictor::Surface => (2, 0),
        };
        let prediction = Prediction {
            mask_view: View::new(&traced_for, origin_m, 1.0),
            source: source as u32,
            predictor,
            unknown,
            lights: u32::MAX.checked_shr(32 - self.lights.min(32)).unwrap_or(0),
        };
        gpu.queue.write_buffer(&self.uniform, 0, bytemuck::bytes_of(&prediction));
        // Only prediction by surface reads what the mask's view saw.
        let depth = if source == Source::OtherView && self.predictor == Predictor::Surface {
            self.mask_depth(gpu, encoder, &traced_for, history, upload)
        } else {
            history.view().clone()
        };
        let picture = wgpu::BindingResource::TextureView;
        let mask_group = group(
            &gpu.device,
            &self.mask_layout,
            &[picture(self.words.words()), picture(&depth), wgpu::BindingResource::Sampler(&self.nearest)],
        );
        self.unknown.clear(encoder);
        {
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("prediction"),
                color_attachments: &[cleared(&targets.visibility)],
                ..wgpu::RenderPassDescriptor::default()
            });
            pass.set_pipeline(&self.pipeline);
            pass.set_bind_group(0, &self.scene_group, &[]);
            pass.set_bind_group(1, &self.surface_groups[history.current()], &[]);
            pass.set_bind_group(2, &mask_group, &[]);
            pass.draw(0..3, 0..1);
        }
        self.unknown.copy(encoder);
    }

    /// Share of the picture's pixels that the mask, or the sky, said something of, in the newest picture whose count is back.
    pub(crate) fn known_share(&mut self) -> Option<f64> {
        self.unknown.newest().map(|unknown| 1.0 - f64::from(unknown) / f64::from(self.pixels))
    }

    fn source(&self, camera: &Camera) -> Source {
        let Some(traced_for) = &self.traced_for else { return Source::None };
        let same_size = (traced_for.width, traced_for.height) == (camera.width, camera.height);
        match self.predictor {
            Predictor::None if same_size => Source::SameView,
            Predictor::None => Source::None,
            _ if traced_for == camera => Source::SameView,
            Predictor::Dissertation(_) | Predictor::Surface => Source::OtherView,
        }
    }

    /// The depth of the mask's view, which is drawn when nothing has it.
    fn mask_depth(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        traced_for: &Camera,
        history: &DepthHistory,
        upload: &SceneUpload,
    ) -> wgpu::TextureView {
        let device = &gpu.device;
        let size = (traced_for.width, traced_for.height);
        let drawn = self.drawn.take().filter(|view| (view.texture().width(), view.texture().height()) == size);
        let drawn = self.drawn.insert(drawn.unwrap_or_else(|| {
            let usage = wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::TEXTURE_BINDING;
            texture(device, "depth of the mask's view", size, DEPTH, usage)
                .create_view(&wgpu::TextureViewDescriptor::default())
        }));
        let depth = *self.depth.get_or_insert_with(|| {
            if let Some(place) = history.find(traced_for) {
                return MaskDepth::Kept(place);
            }
            let matrix = self.depth_pass.group(device, self.uniform.as_entire_binding());
            let mut pass = depth_pass::begin(encoder, "depth of the mask's view", drawn);
            self.depth_pass.draw(&mut pass, &matrix, upload, Faces::Seen);
            MaskDepth::Drawn
        });
        match depth {
            MaskDepth::Kept(place) => history.view_at(place).clone(),
            MaskDepth::Drawn => drawn.clone(),
        }
    }
}

/// The picture's own surfaces, by the place of its depth in the history.
fn surface_groups(
    device: &wgpu::Device,
    layout: &wgpu::BindGroupLayout,
    targets: &Targets,
    history: &DepthHistory,
) -> Vec<wgpu::BindGroup> {
    let picture = wgpu::BindingResource::TextureView;
    history.views().map(|depth| group(device, layout, &[picture(depth), picture(&targets.normal_material)])).collect()
}

/// The layouts of the pass's three groups: the scene and its lights, the picture's surfaces, the mask.
fn layouts(device: &wgpu::Device) -> [wgpu::BindGroupLayout; 3] {
    let storage = |read_only| wgpu::BindingType::Buffer {
        ty: wgpu::BufferBindingType::Storage { read_only },
        has_dynamic_offset: false,
        min_binding_size: None,
    };
    let picture = |sample_type| wgpu::BindingType::Texture {
        sample_type,
        view_dimension: wgpu::TextureViewDimension::D2,
        multisampled: false,
    };
    let (depth, words) = (picture(wgpu::TextureSampleType::Depth), picture(wgpu::TextureSampleType::Uint));
    let layout = |label, bindings: &[wgpu::BindingType]| {
        let entries: Vec<_> = (0..)
            .zip(bindings)
            .map(|(binding, ty)| wgpu::BindGroupLayoutEntry {
                binding,
                visibility: wgpu::ShaderStages::FRAGMENT,
                ty: *ty,
                count: None,
            })
            .collect();
        device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some(label), entries: &entries })
    };
    [
        layout(
            "prediction: scene",
            &[uniform::<View>(), uniform::<Lighting>(), depth, storage(true), uniform::<Prediction>(), storage(false)],
        ),
        layout("prediction: surfaces", &[depth, words]),
        layout("prediction: mask", &[words, depth, wgpu::BindingType::Sampler(wgpu::SamplerBindingType::NonFiltering)]),
    ]
}

fn group(
    device: &wgpu::Device,
    layout: &wgpu::BindGroupLayout,
    resources: &[wgpu::BindingResource<'_>],
) -> wgpu::BindGroup {
    let entries: Vec<_> = (0..)
        .zip(resources)
        .map(|(binding, resource)| wgpu::BindGroupEntry { binding, resource: resource.clone() })
        .collect();
    device.create_bind_group(&wgpu::BindGroupDescriptor { label: Some("prediction"), layout, entries: &entries })
}
