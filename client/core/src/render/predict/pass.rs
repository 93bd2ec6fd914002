//! Runs a frame's prediction.

use bytemuck::Zeroable as _;
use gnomon_protocol::{limits::MAX_LAYERS, mask::MaskShape};
use gnomon_scene::{
    Light, Scene,
    camera::{Camera, Space},
};
use gnomon_shaders::{
    gpu::Gpu,
    shading::{MAX_MASK_LAYERS, MaskLayer, Prediction, View},
};

use super::{
    bindings,
    depth_history::DepthHistory,
    depth_pass::{DepthPass, Faces},
    kernels::{Kernel, Kernels},
    layers::{Layer, Layers},
    mask_view::MaskView,
    mask_words::WordsPass,
    moved::{Moved, Now},
    seen::Seen,
    shadow_map::ShadowMap,
};
use crate::{
    camera::Viewpoint,
    predictor::Predictor,
    render::{
        counts::Counts,
        error::RenderError,
        pipeline::{Variable, bind_group, shader},
        scene_upload::SceneUpload,
        targets::Targets,
        work::Work,
    },
};

// `shaders` does not depend on the protocol crate.
const _: () = assert!(MAX_LAYERS == MAX_MASK_LAYERS);

#[derive(Debug)]
pub(crate) struct PredictPass {
    predictor: Predictor,
    kernels: Kernels,
    scene_group: wgpu::BindGroup,
    surface_layout: wgpu::BindGroupLayout,
    mask_layout: wgpu::BindGroupLayout,
    /// The picture's own surfaces, by the slot of its depth in the history.
    surface_groups: Vec<wgpu::BindGroup>,
    nearest: wgpu::Sampler,
    uniform: Variable<Prediction>,
    depth_pass: DepthPass,
    shadow_map: ShadowMap,
    moved: Moved,
    /// Uniforms of the picture.
    view: wgpu::Buffer,
    lighting: wgpu::Buffer,
    words_pass: WordsPass,
    /// Pixels with unknown visibility.
    unknown: Counts<()>,
    newest_unknown: Option<u32>,
    lights: u32,
    pixels: u32,
    pub(super) layers: Layers,
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
        let depth_pass = DepthPass::new(gpu, upload)?;
        let shadow_map = ShadowMap::new(gpu, scene, upload)?;
        let moved = Moved::new(gpu, (scene, upload), (&depth_pass, view), (targets, history))?;
        let unknown = Counts::new(device, "unknown pixels", 1);
        let uniform = Variable::new(gpu, "prediction");
        let [scene_layout, surface_layout, mask_layout] = bindings::layouts(gpu);
        let picture = wgpu::BindingResource::TextureView;
        let scene_group = bind_group(
            device,
            "prediction",
            &scene_layout,
            &[
                view.as_entire_binding(),
                lighting.as_entire_binding(),
                picture(&shadow_map.texture),
                shadow_map.views.as_entire_binding(),
                uniform.buffer().as_entire_binding(),
                unknown.binding(),
                moved.before.as_entire_binding(),
            ],
        );
        let surface_groups = surface_groups(device, &surface_layout, (targets, history), &moved);
        let module = shader(gpu, "shading/predict.wgsl")?;
        let words_pass = WordsPass::new(gpu)?;
        let lights = u32::try_from(scene.lights.len()).unwrap_or(u32::MAX);
        // The mask must be bound even when there is none.
        let smallest =
            MaskShape::new(1, 1, lights.clamp(1, 32)).map_err(|error| RenderError::Device(error.to_string()))?;
        let layers = Layers::new(gpu, &words_pass, smallest)?;
        let kernels = Kernels::new(module, [scene_layout, surface_layout.clone(), mask_layout.clone()]);
        Ok(Self {
            predictor,
            kernels,
            scene_group,
            surface_layout,
            mask_layout,
            surface_groups,
            nearest: device.create_sampler(&wgpu::SamplerDescriptor::default()),
            uniform,
            depth_pass,
            shadow_map,
            moved,
            view: view.clone(),
            lighting: lighting.clone(),
            words_pass,
            unknown,
            newest_unknown: None,
            lights,
            pixels: targets.width * targets.height,
            layers,
        })
    }

    pub(crate) fn depth_pass(&self) -> &DepthPass {
        &self.depth_pass
    }

    /// The client's own shadow maps.
    pub(crate) fn shadow_map(&self) -> &ShadowMap {
        &self.shadow_map
    }

    /// What shadow maps and late masks took so far.
    pub(crate) fn work(&self) -> Work {
        self.shadow_map.work() + self.moved.work()
    }

    /// Makes what late masks take where lights are edited in a scene in which nothing moves, once there is need.
    ///
    /// # Errors
    /// If the adapter failed.
    pub(crate) fn follow_edits(
        &mut self,
        gpu: &Gpu,
        upload: &SceneUpload,
        (targets, history): (&Targets, &DepthHistory),
    ) -> Result<(), RenderError> {
        if upload.movers().is_none() || self.moved.is_live() {
            return Ok(());
        }
        self.shadow_map.follow_edits(gpu)?;
        self.moved.begin(gpu, (&Scene::default(), upload), (&self.depth_pass, &self.view))?;
        self.resize(&gpu.device, targets, history);
        Ok(())
    }

    /// Takes the lights of another time, at which everything is drawn anew.
    pub(crate) fn set_lights(&mut self, gpu: &Gpu, lights: &[Light]) {
        self.shadow_map.set_lights(gpu, lights);
    }

    /// Ensures that the shadow maps are drawn before what `encoder` does next, for what is seen.
    pub(crate) fn need_shadow_map(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        upload: &SceneUpload,
        seen: &Seen,
    ) {
        self.shadow_map.need(gpu, encoder, (&self.depth_pass, upload), seen);
    }

    /// Compiles what pictures take. With `own_view`, only what those take that have whole masks of their own views.
    pub(crate) fn compile(&mut self, gpu: &Gpu, upload: &SceneUpload, own_view: bool) {
        if own_view {
            self.kernels.get(&gpu.device, Kernel::OwnView);
            return;
        }
        let (layered, moved) = (false, upload.movers().is_some());
        for kernel in [Kernel::First { layered, moved }, Kernel::Every { layered, moved }, Kernel::WithoutMask] {
            self.kernels.get(&gpu.device, kernel);
        }
        self.depth_pass.compile(upload, Faces::Both);
        self.moved.compile(&gpu.device, upload);
    }

    /// Whether every light reaches everything, for want of masks and of a predictor.
    pub(crate) fn knows_nothing(&self) -> bool {
        self.predictor != Predictor::Surface && self.mask_views().next().is_none()
    }

    /// Whether shadow maps say what masks do not.
    pub(crate) fn by_surface(&self) -> bool {
        self.predictor == Predictor::Surface
    }

    /// Sets the predictor from the next picture on.
    pub(crate) fn set_predictor(&mut self, predictor: Predictor) {
        self.predictor = predictor;
    }

    /// Changes the pictures' size. The masks stay.
    pub(crate) fn resize(&mut self, device: &wgpu::Device, targets: &Targets, history: &DepthHistory) {
        self.moved.resize(device, targets, history);
        self.surface_groups = surface_groups(device, &self.surface_layout, (targets, history), &self.moved);
        self.pixels = targets.width * targets.height;
    }

    /// Uploads a mask, or clears them. Returns whether the mask is used: its lights must be the scene's, and its size
    /// its camera's. A partial mask is laid over earlier ones.
    ///
    /// # Errors
    /// If a mask of this size exceeds a limit of the adapter.
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
            self.layers = Layers::new(gpu, &self.words_pass, view.mask.shape())?;
        }
        self.layers.push(gpu, encoder, &self.words_pass, view);
        Ok(true)
    }

    /// Newest first.
    pub(crate) fn mask_views(&self) -> impl Iterator<Item = &Viewpoint> {
        self.layers.stack().iter().map(|layer| &layer.traced_for)
    }

    /// Writes the visibility picture. The G-buffer holds what `seen` sees.
    pub(crate) fn encode(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        (seen, space, visibility_share): (&Viewpoint, Space, f32),
        (targets, history, upload): (&Targets, &DepthHistory, &mut SceneUpload),
    ) {
        let (predictor, unknown) = self.predictor.shader_constants();
        let (layers, count) = self.usable_layers(seen, space);
        let prediction = Prediction {
            layers,
            // At most `MAX_LAYERS`.
            count: u32::try_from(count).unwrap_or(0),
            predictor,
            unknown,
            lights: u32::MAX.checked_shr(32 - self.lights.min(32)).unwrap_or(0),
        };
        self.uniform.set(&gpu.queue, prediction);
        let in_picture = Seen::new(&seen.camera, space);
        // Only prediction by surface reads the depth of the masks' views.
        let mut moved = false;
        if self.predictor == Predictor::Surface && layers[..count].iter().any(|layer| layer.same_view == 0) {
            self.layers.need_depth(gpu, encoder, (count, space), &self.depth_pass, (history, upload));
            if upload.movers().is_some() {
                let (view, lighting, scene) = (&self.view, &self.lighting, &seen.scene);
                let now = Now { view, lighting, space, scene, seen: &in_picture };
                let (masks, map) = (&self.layers.stack()[..count], &mut self.shadow_map);
                // What was then comes first, while it is shown.
                self.moved.draw_then(gpu, encoder, (masks, now), (&mut *map, &self.depth_pass, &mut *upload));
                upload.show_now(&gpu.device, encoder);
                map.need(gpu, encoder, (&self.depth_pass, upload), &in_picture);
                moved = self.moved.encode(gpu, encoder, (masks, now), (targets, history), (&*map, &*upload));
            }
        }
        let mask_group = self.layers.group(&gpu.device, &self.mask_layout, &self.nearest).clone();
        let layered = layers[..count].iter().any(|layer| layer.whole == 0);
        let (first, every) = if count == 0 {
            (None, Kernel::WithoutMask)
        } else if visibility_share >= 1.0 && !layered && layers[0].same_view == 1 {
            (None, Kernel::OwnView)
        } else {
            let puts_off = visibility_share >= 1.0 && self.predictor == Predictor::Surface;
            (puts_off.then_some(Kernel::First { layered, moved }), Kernel::Every { layered, moved })
        };
        if every != Kernel::OwnView && self.by_surface() {
            self.need_shadow_map(gpu, encoder, upload, &in_picture);
        }
        let first = first.map(|first| self.kernels.get(&gpu.device, first));
        let every = self.kernels.get(&gpu.device, every);
        self.unknown.clear(encoder);
        let groups = [&self.scene_group, &self.surface_groups[history.current()], &mask_group];
        targets.put_off.run(encoder, "prediction", (first.as_ref(), &every), &groups);
        self.unknown.copy(encoder, ());
    }

    /// Returns the share of pixels known from masks (the sky counts), for the newest picture whose count was read back.
    pub(crate) fn known_share(&mut self) -> Option<f64> {
        let newest = self.unknown.take_newest().and_then(|(words, ())| words.first().copied());
        self.newest_unknown = newest.or(self.newest_unknown);
        self.newest_unknown.map(|unknown| 1.0 - f64::from(unknown) / f64::from(self.pixels))
    }

    /// Returns the masks from which a picture for `seen` is predicted, and their number.
    fn usable_layers(&self, seen: &Viewpoint, space: Space) -> ([MaskLayer; MAX_LAYERS], usize) {
        let mut layers = [MaskLayer::zeroed(); MAX_LAYERS];
        let size = |camera: &Camera| (camera.width, camera.height);
        // The baselines read only the newest mask, missing tiles included.
        let most = if self.predictor == Predictor::Surface { MAX_LAYERS } else { 1 };
        let stack = self.layers.stack().iter().take(most);
        let fits =
            |layer: &&Layer| self.predictor != Predictor::None || size(&layer.traced_for.camera) == size(&seen.camera);
        let usable = stack.filter(fits);
        let mut count = 0;
        for (place, layer) in layers.iter_mut().zip(usable) {
            let same_view = self.predictor == Predictor::None || layer.traced_for == *seen;
            *place = MaskLayer {
                view: View::new(&layer.traced_for.camera, space, 1.0),
                slot: layer.slot,
                same_view: same_view.into(),
                whole: u32::from(layer.coverage.is_none() || most == 1),
                same_time: u32::from(layer.is_of(&seen.scene)),
            };
            count += 1;
        }
        (layers, count)
    }
}

/// The picture's own surfaces, by the slot of its depth in the history.
fn surface_groups(
    device: &wgpu::Device,
    layout: &wgpu::BindGroupLayout,
    (targets, history): (&Targets, &DepthHistory),
    moved: &Moved,
) -> Vec<wgpu::BindGroup> {
    let picture = wgpu::BindingResource::TextureView;
    let group = |depth| {
        let resources = [
            picture(depth),
            picture(&targets.normal_material),
            picture(&targets.visibility),
            targets.put_off.binding(),
            picture(&moved.pieces),
            picture(&moved.changed),
        ];
        bind_group(device, "prediction", layout, &resources)
    };
    history.views().map(group).collect()
}
