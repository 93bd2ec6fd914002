//! The prediction pass: from masks that were traced for other views to the visibility of every pixel of this one.
//!
//! [`mask_words`] turns the received bit planes into a word a pixel, [`layers`] keeps the newest masks, [`depth_history`] tells what
//! their views saw, or [`depth_pass`] draws it anew, [`shadow_map`] fills in what it did not see, and [`known`] counts how much that was. The shading
//! passes read the result: two words a pixel (`wgsl/shading/predict.wgsl`).

pub(crate) mod depth_history;
pub(crate) mod depth_pass;
mod known;
mod layers;
mod mask_words;
pub(crate) mod shadow_map;
#[cfg(test)]
mod tests;

use bytemuck::Zeroable as _;
use glam::DVec3;
use gnomon_protocol::{
    coverage::Coverage,
    limits::MAX_LAYERS,
    mask::{Mask, MaskShape},
};
use gnomon_scene::{Scene, camera::Camera};
use gnomon_shaders::{
    gpu::Gpu,
    shading::{Lighting, MAX_MASK_LAYERS, MaskLayer, Prediction, View},
};

use self::{
    depth_history::DepthHistory, depth_pass::DepthPass, known::UnknownCount, layers::Layers, mask_words::WordsPass,
    shadow_map::ShadowMap,
};
use super::{
    RenderError, cleared, covering_pipeline_with,
    scene_upload::SceneUpload,
    shader,
    targets::{Targets, VISIBILITY},
    uniform,
};
use crate::predictor::{Predictor, Unknown};

// `shaders` knows nothing of the protocol.
const _: () = assert!(MAX_LAYERS == MAX_MASK_LAYERS);

/// A mask, and the view that it was traced for.
#[derive(Debug, Clone, Copy)]
pub struct MaskView<'a> {
    /// The mask.
    pub mask: &'a Mask,
    /// What of it has come; nothing is all.
    pub coverage: Option<&'a Coverage>,
    /// Whether it is the newest mask once more, of which more has come.
    pub more: bool,
    /// The camera that it was traced for, with the mask's own width, height and field of view.
    pub traced_for: &'a Camera,
}

/// The pass and everything that it remembers.
#[derive(Debug)]
pub(crate) struct PredictPass {
    pub(crate) predictor: Predictor,
    /// For one whole mask, or none, and for several.
    pipelines: [wgpu::RenderPipeline; 2],
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
    layers: Layers,
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
        let pipelines = [0.0, 1.0].map(|layered| {
            covering_pipeline_with(device, &module, &layouts, ("predict", &[("layered", layered)]), VISIBILITY)
        });
        let words_pass = WordsPass::new(device)?;
        let lights = u32::try_from(scene.lights.len()).unwrap_or(u32::MAX);
        // A picture without a mask still binds one.
        let smallest =
            MaskShape::new(1, 1, lights.clamp(1, 32)).map_err(|error| RenderError::Device(error.to_string()))?;
        let layers = Layers::new(device, &words_pass, smallest)?;
        Ok(Self {
            predictor,
            pipelines,
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
            layers,
        })
    }

    /// Goes on with pictures of another size. The mask stays: it is carried over.
    pub(crate) fn resize(&mut self, device: &wgpu::Device, targets: &Targets, history: &DepthHistory) {
        self.surface_groups = surface_groups(device, &self.surface_layout, targets, history);
        self.pixels = targets.width * targets.height;
    }

    /// Takes another mask, or none. Whether it can be used is the answer: its lights must be the scene's, and its size the
    /// camera's. One that has not come whole lies over those before it.
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
        let Some(view) = view.filter(fits) else {
            self.layers.clear();
            return Ok(false);
        };
        if self.layers.shape() != view.mask.shape() {
            self.layers = Layers::new(&gpu.device, &self.words_pass, view.mask.shape())?;
        }
        self.layers.push(gpu, encoder, &self.words_pass, view);
        Ok(true)
    }

    /// The views of the masks, the newest first.
    pub(crate) fn mask_views(&self) -> impl Iterator<Item = &Camera> {
        self.layers.stack().iter().map(|layer| &layer.traced_for)
    }

    /// Predicts into the visibility picture. The G-buffer holds what `camera` sees.
    pub(crate) fn encode(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        (camera, origin_m): (&Camera, DVec3),
        (targets, history, upload): (&Targets, &DepthHistory, &SceneUpload),
    ) {
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
        let (layers, count) = self.looked_up_in(camera, origin_m);
        let prediction = Prediction {
            layers,
            // At most `MAX_LAYERS`.
            count: u32::try_from(count).unwrap_or(0),
            predictor,
            unknown,
            lights: u32::MAX.checked_shr(32 - self.lights.min(32)).unwrap_or(0),
        };
        gpu.queue.write_buffer(&self.uniform, 0, bytemuck::bytes_of(&prediction));
        // Only prediction by surface reads what the masks' views saw.
        if self.predictor == Predictor::Surface && layers[..count].iter().any(|layer| layer.same_view == 0) {
            self.layers.need_depth(gpu, encoder, (count, origin_m), &self.depth_pass, (history, upload));
        }
        let mask_group = self.mask_group(&gpu.device);
        self.unknown.clear(encoder);
        {
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("prediction"),
                color_attachments: &[cleared(&targets.visibility)],
                ..wgpu::RenderPassDescriptor::default()
            });
            let layered = layers[..count].iter().any(|layer| layer.whole == 0);
            pass.set_pipeline(&self.pipelines[usize::from(layered)]);
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

    /// The masks that a picture is predicted from, and how many they are.
    fn looked_up_in(&self, camera: &Camera, origin_m: DVec3) -> ([MaskLayer; MAX_LAYERS], usize) {
        let mut layers = [MaskLayer::zeroed(); MAX_LAYERS];
        let size = |camera: &Camera| (camera.width, camera.height);
        // Those before it are looked at by surface only; otherwise what has not come is taken as it was.
        let most = if self.predictor == Predictor::Surface { MAX_LAYERS } else { 1 };
        let stack = self.layers.stack().iter().take(most);
        let usable = stack.filter(|layer| self.predictor != Predictor::None || size(&layer.traced_for) == size(camera));
        let mut count = 0;
        for (place, layer) in layers.iter_mut().zip(usable) {
            let same_view = self.predictor == Predictor::None || layer.traced_for == *camera;
            *place = MaskLayer {
                view: View::new(&layer.traced_for, origin_m, 1.0),
                slot: layer.slot,
                same_view: same_view.into(),
                whole: u32::from(layer.coverage.is_none() || most == 1),
                unused: 0,
            };
            count += 1;
        }
        (layers, count)
    }

    fn mask_group(&self, device: &wgpu::Device) -> wgpu::BindGroup {
        let picture = wgpu::BindingResource::TextureView;
        let [words, coverage, depth] = self.layers.pictures();
        let resources =
            [picture(&words), picture(&coverage), picture(&depth), wgpu::BindingResource::Sampler(&self.nearest)];
        group(device, &self.mask_layout, &resources)
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
    let texture =
        |view_dimension, sample_type| wgpu::BindingType::Texture { sample_type, view_dimension, multisampled: false };
    let pictures = |dimension| {
        [wgpu::TextureSampleType::Depth, wgpu::TextureSampleType::Uint].map(|sample| texture(dimension, sample))
    };
    let [depth, words] = pictures(wgpu::TextureViewDimension::D2);
    let [depths, all_words] = pictures(wgpu::TextureViewDimension::D2Array);
    let nearest = wgpu::BindingType::Sampler(wgpu::SamplerBindingType::NonFiltering);
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
        layout("prediction: masks", &[all_words, all_words, depths, nearest]),
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
