//! The masks that visibility is looked up in, newest first: tiles missing from one may be in an earlier one.
//!
//! A complete mask stands alone. A partial one lies over earlier masks. Each has its own view and that view's depth, so
//! a value found in any of them was traced for that very point, and nothing is resampled twice. All are layers of the
//! same textures, at 8 bytes a pixel. There is one layer until the first partial mask, and then as many as were ever
//! needed at once.

use gnomon_protocol::{
    coverage::{Coverage, max_layers},
    limits::MAX_LAYERS,
    mask::MaskShape,
};
use gnomon_scene::{SceneAt, camera::Space};
use gnomon_shaders::{gpu::Gpu, shading::View};

use super::{
    depth_history::DepthHistory,
    depth_pass::{self, DepthPass, Faces, Part},
    mask_view::MaskView,
    mask_words::{MaskPlanes, WORDS, WordsPass},
};
use crate::{
    camera::Viewpoint,
    render::{
        error::RenderError,
        pipeline::{Variable, bind_group, check_side},
        scene_upload::SceneUpload,
        targets::{DEPTH, layered_texture},
    },
};

#[derive(Debug)]
pub(crate) struct Layers {
    shape: MaskShape,
    planes: MaskPlanes,
    words: wgpu::Texture,
    /// Each layer of [`Self::words`], to be written.
    written: Vec<wgpu::BindGroup>,
    /// Bits of the lights that arrived, one texel for each tile position.
    coverage: wgpu::Texture,
    /// One texel until it is needed: most pictures of clients that wait for masks need none.
    depth: wgpu::Texture,
    /// Newest first.
    stack: Vec<Layer>,
    /// Binds the textures; `None` when one was replaced.
    group: Option<wgpu::BindGroup>,
    /// Views whose depth was drawn, by slot.
    views: Vec<(Variable<View>, wgpu::BindGroup)>,
}

#[derive(Debug, Clone)]
pub(crate) struct Layer {
    /// Layer of the textures.
    pub(crate) slot: u32,
    /// The view that it was traced for.
    pub(crate) traced_for: Viewpoint,
    /// `None` if all tiles have arrived.
    pub(crate) coverage: Option<Coverage>,
    /// True if the view's depth was drawn.
    has_depth: bool,
}

impl Layer {
    /// Whether it was traced for this state of the scene.
    pub(crate) fn is_of(&self, scene: &SceneAt) -> bool {
        self.traced_for.scene == *scene
    }
}

impl Layers {
    /// Allocates memory for one mask of this shape.
    ///
    /// # Errors
    /// If it exceeds a limit of the adapter.
    pub(crate) fn new(gpu: &Gpu, pass: &WordsPass, shape: MaskShape) -> Result<Self, RenderError> {
        let device = &gpu.device;
        check_side(device, shape.width().max(shape.height()))?;
        let planes = pass.memory(gpu, shape)?;
        let (words, coverage) = (words(device, shape, 1), coverage(device, shape, 1));
        let depth = depth(device, [1; 3]);
        let stack = Vec::with_capacity(MAX_LAYERS);
        let written = written(device, pass, &words);
        Ok(Self { shape, planes, words, written, coverage, depth, stack, group: None, views: Vec::new() })
    }

    pub(crate) fn shape(&self) -> MaskShape {
        self.shape
    }

    /// Newest first.
    pub(crate) fn stack(&self) -> &[Layer] {
        &self.stack
    }

    pub(crate) fn clear(&mut self) {
        self.stack.clear();
    }

    /// Lays a mask of [`Self::shape`] over the others, or replaces them if it is complete.
    pub(crate) fn push(&mut self, gpu: &Gpu, encoder: &mut wgpu::CommandEncoder, pass: &WordsPass, view: MaskView<'_>) {
        let MaskView { mask, coverage, more, .. } = view;
        let traced_for = view.viewpoint();
        let coverage = coverage.filter(|coverage| !coverage.is_whole()).cloned();
        let newest = self.stack.first().filter(|newest| more && newest.traced_for == traced_for).cloned();
        if coverage.is_none() {
            self.stack.clear();
        } else if newest.is_some() {
            self.stack.remove(0);
        }
        let has_depth = newest.as_ref().is_some_and(|newest| newest.has_depth);
        let slot = newest.map_or_else(|| self.free_slot(&gpu.device, encoder, pass), |newest| newest.slot);
        pass.write(&gpu.queue, encoder, (&self.planes, mask), &self.written[slot as usize]);
        if let Some(coverage) = &coverage {
            self.write_coverage(&gpu.queue, slot, coverage);
        }
        self.stack.insert(0, Layer { slot, traced_for, coverage, has_depth });
    }

    /// Returns a free slot, or the oldest mask's if there is none.
    fn free_slot(&mut self, device: &wgpu::Device, encoder: &mut wgpu::CommandEncoder, pass: &WordsPass) -> u32 {
        let most = max_layers(self.shape);
        self.stack.truncate(most - 1);
        // At most `MAX_LAYERS`.
        let most = u32::try_from(most).unwrap_or(1);
        let slot = (0..most).find(|slot| self.stack.iter().all(|layer| layer.slot != *slot)).unwrap_or(0);
        if slot >= self.words.depth_or_array_layers() {
            self.grow(device, encoder, (slot + 1).next_power_of_two().min(most));
            self.written = written(device, pass, &self.words);
        }
        slot
    }

    /// Moves the layers to larger textures.
    fn grow(&mut self, device: &wgpu::Device, encoder: &mut wgpu::CommandEncoder, count: u32) {
        self.group = None;
        let move_over = |encoder: &mut wgpu::CommandEncoder, old: &mut wgpu::Texture, new: wgpu::Texture| {
            encoder.copy_texture_to_texture(old.as_image_copy(), new.as_image_copy(), old.size());
            *old = new;
        };
        move_over(encoder, &mut self.words, words(device, self.shape, count));
        move_over(encoder, &mut self.coverage, coverage(device, self.shape, count));
        if self.stack.iter().any(|layer| layer.has_depth) {
            move_over(encoder, &mut self.depth, depth(device, [self.shape.width(), self.shape.height(), count]));
        }
    }

    fn write_coverage(&self, queue: &wgpu::Queue, slot: u32, coverage: &Coverage) {
        let [width, height] = Coverage::places(self.shape);
        queue.write_texture(
            wgpu::TexelCopyTextureInfo {
                origin: wgpu::Origin3d { x: 0, y: 0, z: slot },
                ..self.coverage.as_image_copy()
            },
            bytemuck::cast_slice(coverage.words()),
            wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(width * 4), rows_per_image: None },
            wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
        );
    }

    /// Ensures that the newest `count` masks have the depth of their views; draws it if no picture has it. What moves
    /// is drawn where it was; [`SceneUpload::show_now`] is to follow.
    pub(crate) fn need_depth(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        (count, space): (usize, Space),
        pass: &DepthPass,
        (history, upload): (&DepthHistory, &mut SceneUpload),
    ) {
        let wanted = [self.shape.width(), self.shape.height(), self.words.depth_or_array_layers()];
        let had = self.depth.size();
        if [had.width, had.height, had.depth_or_array_layers] != wanted {
            self.depth = depth(&gpu.device, wanted);
            self.group = None;
            self.stack.iter_mut().for_each(|layer| layer.has_depth = false);
        }
        let depth = &self.depth;
        for layer in self.stack.iter_mut().take(count).filter(|layer| !layer.has_depth) {
            layer.has_depth = true;
            if let Some(place) = history.find(&layer.traced_for) {
                let seen = history.view_at(place).texture();
                let mut to = depth.as_image_copy();
                to.origin.z = layer.slot;
                encoder.copy_texture_to_texture(seen.as_image_copy(), to, seen.size());
                continue;
            }
            while self.views.len() <= layer.slot as usize {
                let view = Variable::new(gpu, "mask's view");
                let group = pass.group(&gpu.device, view.buffer().as_entire_binding());
                self.views.push((view, group));
            }
            let (view, group) = &mut self.views[layer.slot as usize];
            view.set(&gpu.queue, View::new(&layer.traced_for.camera, space, 1.0));
            upload.show(&gpu.device, encoder, &layer.traced_for.scene);
            let drawn = layer_of(depth, layer.slot);
            let mut render = depth_pass::begin(encoder, "depth of the mask's view", &drawn);
            pass.draw(&mut render, group, upload, (Part::All, Faces::Seen));
        }
    }

    /// Words, coverage and depth of all layers, and a sampler. The depth is valid only after [`Self::need_depth`].
    pub(crate) fn group(
        &mut self,
        device: &wgpu::Device,
        layout: &wgpu::BindGroupLayout,
        sampler: &wgpu::Sampler,
    ) -> &wgpu::BindGroup {
        self.group.get_or_insert_with(|| {
            let [words, coverage, depth] = [&self.words, &self.coverage, &self.depth].map(|texture| {
                texture.create_view(&wgpu::TextureViewDescriptor {
                    dimension: Some(wgpu::TextureViewDimension::D2Array),
                    ..wgpu::TextureViewDescriptor::default()
                })
            });
            let picture = wgpu::BindingResource::TextureView;
            let resources =
                [picture(&words), picture(&coverage), picture(&depth), wgpu::BindingResource::Sampler(sampler)];
            bind_group(device, "prediction", layout, &resources)
        })
    }
}

fn words(device: &wgpu::Device, shape: MaskShape, count: u32) -> wgpu::Texture {
    let usage = wgpu::TextureUsages::STORAGE_BINDING | MOVED;
    layered_texture(device, "mask words", [shape.width(), shape.height(), count], WORDS, usage)
}

fn written(device: &wgpu::Device, pass: &WordsPass, words: &wgpu::Texture) -> Vec<wgpu::BindGroup> {
    (0..words.depth_or_array_layers()).map(|slot| pass.target(device, &layer_of(words, slot))).collect()
}

fn coverage(device: &wgpu::Device, shape: MaskShape, count: u32) -> wgpu::Texture {
    let [across, down] = Coverage::places(shape);
    layered_texture(device, "mask coverage", [across, down, count], WORDS, MOVED)
}

fn depth(device: &wgpu::Device, size: [u32; 3]) -> wgpu::Texture {
    layered_texture(device, "depth of the masks' views", size, DEPTH, wgpu::TextureUsages::RENDER_ATTACHMENT | MOVED)
}

/// Layers are read, and moved to larger textures.
const MOVED: wgpu::TextureUsages =
    wgpu::TextureUsages::TEXTURE_BINDING.union(wgpu::TextureUsages::COPY_SRC).union(wgpu::TextureUsages::COPY_DST);

fn layer_of(texture: &wgpu::Texture, slot: u32) -> wgpu::TextureView {
    texture.create_view(&wgpu::TextureViewDescriptor {
        dimension: Some(wgpu::TextureViewDimension::D2),
        base_array_layer: slot,
        array_layer_count: Some(1),
        ..wgpu::TextureViewDescriptor::default()
    })
}
