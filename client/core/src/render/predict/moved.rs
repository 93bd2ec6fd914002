//! What prediction must know where something moves: the piece that a pixel shows, where that was when a mask was
//! traced, and which lights' shadows have changed since (`changed.wgsl`).
//!
//! Shadows are compared in two sets of maps, of the picture's time and of the newest mask's, and only those of lights
//! that move or that something moving is near. A scene in which nothing moves has none of this.

use gnomon_protocol::limits::MAX_LAYERS;
use gnomon_scene::{Scene, SceneAt, camera::Space};
use gnomon_shaders::{
    gpu::Gpu,
    shading::{Before, Lighting, View},
};

use super::{
    depth_history::DepthHistory,
    depth_pass::DepthPass,
    layers::Layer,
    pieces::{PiecesPass, format},
    seen::Seen,
    shadow_map::ShadowMap,
    touched,
};
use crate::render::{
    error::RenderError,
    exposure::Exposure,
    pipeline::{
        Variable, bind_group, bind_group_layout, compute, compute_pipeline, dispatch_pixels, picture, shader, storage,
        uniform, written_picture,
    },
    put_off::PutOff,
    scene_upload::SceneUpload,
    targets::{Targets, texture},
    work::Work,
};

/// Bits of lights.
const WORD: wgpu::TextureFormat = wgpu::TextureFormat::R32Uint;

/// Side of a tile of pixels. Twin of `TILE_PX` in `changed.wgsl`.
const TILE_PX: u32 = 8;

#[derive(Debug)]
pub(super) struct Moved {
    /// Each pixel's piece, and where it was: see `pieces.wgsl`.
    pub(super) pieces: wgpu::TextureView,
    /// Their format.
    format: wgpu::TextureFormat,
    /// Lights whose shadow has changed, one bit each.
    pub(super) changed: wgpu::TextureView,
    /// [`Before`] of each layer and piece.
    pub(super) before: wgpu::Buffer,
    /// `None` if everything rests, and nothing was edited.
    live: Option<Live>,
}

#[derive(Debug)]
struct Live {
    pieces_pass: PiecesPass,
    /// Finds the lights that each tile's pixels are to be compared for.
    look: wgpu::ComputePipeline,
    /// Compares what rests, if no light has moved, and puts off the other pixels.
    compare_resting: wgpu::ComputePipeline,
    compare: wgpu::ComputePipeline,
    scene_layout: wgpu::BindGroupLayout,
    surface_layout: wgpu::BindGroupLayout,
    /// By the slot of the picture's depth in the history.
    surface_groups: Vec<wgpu::BindGroup>,
    /// [`Before`] of each piece, for the newest mask.
    before: wgpu::Buffer,
    lighting_then: Variable<Lighting>,
    /// What the picture's shadows are compared with, once there was need.
    then: Option<Then>,
    /// Other than that of maps.
    work: Work,
}

#[derive(Debug)]
struct Then {
    /// `None` until it is drawn.
    scene: Option<SceneAt>,
    map: ShadowMap,
    /// [`touched::words`].
    touched: wgpu::TextureView,
    scene_group: wgpu::BindGroup,
}

/// What the comparison reads of the picture.
#[derive(Clone, Copy)]
pub(super) struct Now<'a> {
    pub(super) view: &'a wgpu::Buffer,
    pub(super) lighting: &'a wgpu::Buffer,
    pub(super) space: Space,
    pub(super) scene: &'a SceneAt,
    pub(super) seen: &'a Seen,
}

fn pictures(device: &wgpu::Device, size: (u32, u32), pieces: wgpu::TextureFormat) -> [wgpu::TextureView; 2] {
    [(pieces, wgpu::TextureUsages::RENDER_ATTACHMENT), (WORD, wgpu::TextureUsages::STORAGE_BINDING)].map(
        |(format, usage)| {
            texture(device, "what has moved", size, format, usage | wgpu::TextureUsages::TEXTURE_BINDING)
                .create_view(&wgpu::TextureViewDescriptor::default())
        },
    )
}

/// Tiles of a picture, across and down.
fn tiles((width, height): (u32, u32)) -> (u32, u32) {
    (width.div_ceil(TILE_PX), height.div_ceil(TILE_PX))
}

fn count(scene: &Scene) -> usize {
    scene.animation.as_ref().map_or(0, |animation| animation.pieces.len())
}

fn places(device: &wgpu::Device, count: usize) -> wgpu::Buffer {
    device.create_buffer(&wgpu::BufferDescriptor {
        label: Some("where pieces were"),
        size: (count.max(1) * size_of::<Before>()) as u64,
        usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST,
        mapped_at_creation: false,
    })
}

impl Moved {
    pub(super) fn new(
        gpu: &Gpu,
        (scene, upload): (&Scene, &SceneUpload),
        (depth_pass, view): (&DepthPass, &wgpu::Buffer),
        (targets, history): (&Targets, &DepthHistory),
    ) -> Result<Self, RenderError> {
        let device = &gpu.device;
        let format = format(upload);
        let [picture, changed] = pictures(device, (1, 1), format);
        let before = places(device, count(scene) * MAX_LAYERS);
        let mut moved = Self { pieces: picture, format, changed, before, live: None };
        if upload.movers().is_some() {
            moved.begin(gpu, (scene, upload), (depth_pass, view))?;
        }
        moved.resize(device, targets, history);
        Ok(moved)
    }

    /// Whether something moves or was edited.
    pub(super) fn is_live(&self) -> bool {
        self.live.is_some()
    }

    /// Makes what is needed where something moves or is edited. [`Self::resize`] is to follow.
    pub(super) fn begin(
        &mut self,
        gpu: &Gpu,
        (scene, upload): (&Scene, &SceneUpload),
        (depth_pass, view): (&DepthPass, &wgpu::Buffer),
    ) -> Result<(), RenderError> {
        let pieces_pass = PiecesPass::new(gpu, (scene, upload), (depth_pass, view))?;
        self.live = Some(Live::new(gpu, pieces_pass, count(scene))?);
        Ok(())
    }

    /// Compiles what late masks take.
    pub(super) fn compile(&self, device: &wgpu::Device, upload: &SceneUpload) {
        if let Some(live) = &self.live {
            live.pieces_pass.compile(device, upload);
        }
    }

    /// Changes the pictures' size.
    pub(super) fn resize(&mut self, device: &wgpu::Device, targets: &Targets, history: &DepthHistory) {
        let Some(live) = &mut self.live else { return };
        [self.pieces, self.changed] = pictures(device, (targets.width, targets.height), self.format);
        let view = wgpu::BindingResource::TextureView;
        let (across, down) = tiles((targets.width, targets.height));
        let tiles = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("lights of tiles"),
            size: u64::from(across) * u64::from(down) * size_of::<u32>() as u64,
            usage: wgpu::BufferUsages::STORAGE,
            mapped_at_creation: false,
        });
        let group = |depth| {
            let pictures = [depth, &targets.normal_material, &self.pieces, &self.changed].map(view);
            let resources = [&pictures[..], &[tiles.as_entire_binding(), targets.put_off.binding()]].concat();
            bind_group(device, "changed shadows", &live.surface_layout, &resources)
        };
        live.surface_groups = history.views().map(group).collect();
    }

    /// What late masks of other states took so far, their maps included.
    pub(super) fn work(&self) -> Work {
        let Some(live) = &self.live else { return Work::default() };
        live.work + live.then.as_ref().map(|then| then.map.work()).unwrap_or_default()
    }

    /// Draws the shadow maps of the state of the newest of these layers that is not of the picture's, if there is one.
    /// [`SceneUpload::show_now`] is to follow.
    pub(super) fn draw_then(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        (layers, now): (&[Layer], Now<'_>),
        maps: (&mut ShadowMap, &DepthPass, &mut SceneUpload),
    ) {
        if let Some(live) = &mut self.live
            && let Some(newest) = layers.iter().find(|layer| !layer.is_of(now.scene))
        {
            live.draw_then(gpu, encoder, &newest.traced_for.scene, now, maps);
        }
    }

    /// Finds out what has moved since those of these layers' masks were traced that are of another state of the scene
    /// than the picture. Returns false if there are none. `map` and `upload` show the picture's state.
    pub(super) fn encode(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        (layers, now): (&[Layer], Now<'_>),
        (targets, history): (&Targets, &DepthHistory),
        (map, upload): (&ShadowMap, &SceneUpload),
    ) -> bool {
        let Some(live) = &mut self.live else { return false };
        let others = || layers.iter().enumerate().filter(|(_, layer)| !layer.is_of(now.scene));
        let Some((_, newest)) = others().next() else { return false };
        let Some(movers) = upload.movers() else { return false };
        for (place, layer) in others() {
            // One state is drawn.
            let drawn = layer.is_of(&newest.traced_for.scene);
            let before = movers.before(&movers.moment_at(&layer.traced_for.scene), drawn);
            let offset = (place * size_of_val(&*before)) as u64;
            let before: &[u8] = bytemuck::cast_slice(&before);
            gpu.queue.write_buffer(&self.before, offset, before);
            live.work.bytes += before.len() as u64;
            if layer.slot == newest.slot {
                gpu.queue.write_buffer(&live.before, 0, before);
                live.work.bytes += before.len() as u64;
            }
        }
        live.pieces_pass.encode(&gpu.device, encoder, (&self.pieces, history.view()), upload);
        live.work.passes += 1;
        if let Some(then) = &live.then {
            let words = touched::words(map, &then.map);
            let picture = then.touched.texture();
            let layout = wgpu::TexelCopyBufferLayout {
                bytes_per_row: Some(picture.width() * 4),
                ..wgpu::TexelCopyBufferLayout::default()
            };
            gpu.queue.write_texture(picture.as_image_copy(), bytemuck::cast_slice(&words), layout, picture.size());
            live.work.bytes += size_of_val(&*words) as u64;
            let groups = [&then.scene_group, &live.surface_groups[history.current()]];
            let size = (targets.width, targets.height);
            compute(encoder, "lights of tiles", &live.look, &groups, |pass| dispatch_pixels(pass, tiles(size)));
            // A light that has moved has other shadows everywhere.
            let first = (map.moved(&then.map) == 0).then_some(&live.compare_resting);
            targets.put_off.run(encoder, "changed shadows", (first, &live.compare), &groups);
            live.work.passes += if first.is_some() { 3 } else { 2 };
        }
        true
    }
}

impl Live {
    fn new(gpu: &Gpu, pieces_pass: PiecesPass, pieces: usize) -> Result<Self, RenderError> {
        let device = &gpu.device;
        let [depth, words] = [wgpu::TextureSampleType::Depth, wgpu::TextureSampleType::Uint].map(picture);
        let (view, lighting) = (uniform::<View>(gpu), uniform::<Lighting>(gpu));
        let (maps, before) = ([depth, storage(true)], storage(true));
        let of_scene = [view, lighting, maps[0], maps[1], lighting, maps[0], maps[1], before, words];
        let of_surface = [depth, words, words, written_picture(WORD), storage(false), PutOff::layout()];
        let layout = |bindings: &[wgpu::BindingType]| {
            bind_group_layout(device, "changed shadows", wgpu::ShaderStages::COMPUTE, bindings)
        };
        let (scene_layout, surface_layout) = (layout(&of_scene), layout(&of_surface));
        let module = shader(gpu, "shading/changed.wgsl")?;
        let pipeline = |entry| compute_pipeline(device, &module, &[&scene_layout, &surface_layout], (entry, &[]));
        Ok(Self {
            pieces_pass,
            look: pipeline("look"),
            compare_resting: pipeline("compare_resting"),
            compare: pipeline("compare"),
            scene_layout,
            surface_layout,
            surface_groups: Vec::new(),
            before: places(device, pieces),
            lighting_then: Variable::new(gpu, "lighting of the mask's time"),
            then: None,
            work: Work::default(),
        })
    }

    /// Draws the shadow maps of another state of the scene, and keeps the vertices, unless they are those that were
    /// drawn last.
    fn draw_then(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        scene: &SceneAt,
        now: Now<'_>,
        (map_now, depth_pass, upload): (&mut ShadowMap, &DepthPass, &mut SceneUpload),
    ) {
        // Shadows are looked up where points were then. The same maps are to serve pictures of a little later, too.
        let moved_m = upload.farthest_m(scene).log2().ceil().exp2();
        let seen = now.seen.and_around(moved_m);
        if self.then.as_ref().is_some_and(|then| then.scene.as_ref() == Some(scene) && then.map.serves(&seen)) {
            return;
        }
        if self.then.is_none() {
            let Some(map) = map_now.another(gpu, encoder, depth_pass, upload) else { return };
            self.then = Some(self.then_with(gpu, map, map_now, now));
        }
        let Some(then) = &mut self.then else { return };
        if then.scene.as_ref() != Some(scene) {
            let Some(lights) = upload.movers().map(|movers| movers.moment_at(scene).lights.clone()) else { return };
            // Only where lights are is read.
            let lighting = Exposure::for_reference(1.0).lighting(&lights, now.space);
            self.lighting_then.set(&gpu.queue, lighting);
            then.map.set_lights(gpu, &lights);
            then.scene = Some(scene.clone());
        }
        upload.show(&gpu.device, encoder, scene);
        if let Some(vertices) = &self.pieces_pass.then {
            upload.keep_vertices(encoder, vertices);
        }
        then.map.need(gpu, encoder, (depth_pass, upload), &seen);
    }

    fn then_with(&self, gpu: &Gpu, map: ShadowMap, map_now: &ShadowMap, now: Now<'_>) -> Then {
        let usage = wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST;
        let touched = texture(&gpu.device, "where maps may differ", touched::size(&map), WORD, usage)
            .create_view(&wgpu::TextureViewDescriptor::default());
        let view = wgpu::BindingResource::TextureView;
        let resources = [
            now.view.as_entire_binding(),
            now.lighting.as_entire_binding(),
            view(&map_now.texture),
            map_now.views.as_entire_binding(),
            self.lighting_then.buffer().as_entire_binding(),
            view(&map.texture),
            map.views.as_entire_binding(),
            self.before.as_entire_binding(),
            view(&touched),
        ];
        let scene_group = bind_group(&gpu.device, "changed shadows", &self.scene_layout, &resources);
        Then { scene: None, map, touched, scene_group }
    }
}
