//! Debug views: show the passes' data for each pixel instead of the picture.

use std::{fmt, sync::OnceLock};

use bytemuck::{Pod, Zeroable};
use gnomon_protocol::limits::MAX_LAYERS;
use gnomon_shaders::{gpu::Gpu, shading::View};
use serde::{Deserialize, Serialize};

use super::{
    error::RenderError,
    pipeline::{Variable, bind_group, bind_group_layout, cleared, covering_pipeline, picture, shader, uniform},
    predict::depth_history::DepthHistory,
    targets::Targets,
};

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub enum DebugView {
    #[default]
    Picture,
    /// Visibility of one light, as used for shading.
    Light(u32),
    /// Pixels whose visibility no mask gives, while received visibility counts fully.
    Unknown,
    /// Unknown pixels, and the age of the mask used by each other pixel.
    Age {
        /// Age of each mask in frames, newest first.
        lags: [u32; MAX_LAYERS],
    },
    /// Along the view.
    Depth,
    /// Shading normals, in world space.
    Normals,
}

impl fmt::Display for DebugView {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Picture => f.write_str("picture"),
            Self::Light(k) => write!(f, "light {}", k + 1),
            Self::Unknown => f.write_str("unknown pixels"),
            Self::Age { .. } => f.write_str("age"),
            Self::Depth => f.write_str("depth"),
            Self::Normals => f.write_str("normals"),
        }
    }
}

/// Layout of `Choice` in `debug_view.wgsl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
struct Choice {
    kind: u32,
    light: u32,
    unused_0: u32,
    unused_1: u32,
    lags: [u32; MAX_LAYERS],
}

impl From<DebugView> for Choice {
    fn from(view: DebugView) -> Self {
        let (kind, light, lags) = match view {
            DebugView::Light(k) => (0, k.min(31), [0; MAX_LAYERS]),
            DebugView::Picture | DebugView::Unknown => (1, 0, [0; MAX_LAYERS]),
            DebugView::Age { lags } => (2, 0, lags),
            DebugView::Depth => (3, 0, [0; MAX_LAYERS]),
            DebugView::Normals => (4, 0, [0; MAX_LAYERS]),
        };
        Self { kind, light, unused_0: 0, unused_1: 0, lags }
    }
}

/// Replaces the tone pass.
#[derive(Debug)]
pub(crate) struct DebugPass {
    layout: wgpu::BindGroupLayout,
    view: wgpu::Buffer,
    choice: Variable<Choice>,
    /// By the slot of the picture's depth in the history.
    groups: Vec<wgpu::BindGroup>,
    module: wgpu::ShaderModule,
    format: wgpu::TextureFormat,
    /// Compiled when it is first shown.
    pipeline: OnceLock<wgpu::RenderPipeline>,
}

impl DebugPass {
    pub(crate) fn new(
        gpu: &Gpu,
        view: &wgpu::Buffer,
        targets: &Targets,
        history: &DepthHistory,
        format: wgpu::TextureFormat,
    ) -> Result<Self, RenderError> {
        let device = &gpu.device;
        let layout = layout(gpu);
        let choice = Variable::new(gpu, "debug view");
        let module = shader(gpu, "shading/debug_view.wgsl")?;
        let (view, groups, pipeline) = (view.clone(), Vec::new(), OnceLock::new());
        let mut pass = Self { layout, view, choice, groups, module, format, pipeline };
        pass.resize(device, targets, history);
        Ok(pass)
    }

    pub(crate) fn resize(&mut self, device: &wgpu::Device, targets: &Targets, history: &DepthHistory) {
        let view = wgpu::BindingResource::TextureView;
        let group = |depth| {
            let resources = [
                self.view.as_entire_binding(),
                self.choice.buffer().as_entire_binding(),
                view(&targets.visibility),
                view(depth),
                view(&targets.normal_material),
            ];
            bind_group(device, "debug view", &self.layout, &resources)
        };
        self.groups = history.views().map(group).collect();
    }

    pub(crate) fn encode(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        view: DebugView,
        history: &DepthHistory,
        target: &wgpu::TextureView,
    ) {
        self.choice.set(&gpu.queue, view.into());
        let compile = || covering_pipeline(&gpu.device, &self.module, &[&self.layout], "look", self.format);
        let pipeline = self.pipeline.get_or_init(compile);
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("debug view"),
            color_attachments: &[cleared(target)],
            ..wgpu::RenderPassDescriptor::default()
        });
        pass.set_pipeline(pipeline);
        pass.set_bind_group(0, &self.groups[history.current()], &[]);
        pass.draw(0..3, 0..1);
    }
}

fn layout(gpu: &Gpu) -> wgpu::BindGroupLayout {
    let bindings = [
        uniform::<View>(gpu),
        uniform::<Choice>(gpu),
        picture(wgpu::TextureSampleType::Uint),
        picture(wgpu::TextureSampleType::Depth),
        picture(wgpu::TextureSampleType::Uint),
    ];
    bind_group_layout(&gpu.device, "debug view", wgpu::ShaderStages::FRAGMENT, &bindings)
}

#[cfg(test)]
mod tests {
    use gnomon_protocol::mask::{Mask, MaskShape};

    use super::*;
    use crate::render::testing::{camera, draw, floor_and_lights, gpu, renderer};

    const SIZE: (u32, u32) = (96, 54);

    fn mask() -> Mask {
        let mut mask = Mask::new(MaskShape::new(SIZE.0, SIZE.1, 2).unwrap());
        for (index, word) in mask.words_mut().iter_mut().enumerate() {
            *word = 0x9E37_79B9_7F4A_7C15_u64.wrapping_mul(index as u64 + 1);
        }
        mask
    }

    #[test]
    fn lights_split_and_views_change_only_their_own_part() {
        let gpu = gpu();
        let (scene, mask) = (floor_and_lights(), mask());
        let camera = camera(SIZE.0, SIZE.1);
        let mut one = renderer(&gpu, &scene, mask.shape());
        let plain = draw(&gpu, &mut one, &camera, Some(&mask));
        let lit = draw(&gpu, &mut one, &camera, None);
        one.set_split(Some(SIZE.0 / 2));
        let split = draw(&gpu, &mut one, &camera, Some(&mask));
        let half = SIZE.0 as usize * 2;
        let rows = |picture: &[u8]| picture.chunks(half * 2).map(<[u8]>::to_vec).collect::<Vec<_>>();
        for ((plain, lit), split) in rows(&plain.rgba).iter().zip(rows(&lit.rgba)).zip(rows(&split.rgba)) {
            assert_eq!((&split[..half], &split[half..]), (&plain[..half], &lit[half..]));
        }
        one.set_split(None);
        one.set_lights_on(0);
        let dark = draw(&gpu, &mut one, &camera, Some(&mask));
        assert!(dark.rgba != plain.rgba);
        one.set_lights_on(u32::MAX);
        let views =
            [DebugView::Light(0), DebugView::Light(1), DebugView::Unknown, DebugView::Depth, DebugView::Normals];
        let mut seen = vec![plain.rgba.clone()];
        for view in views {
            one.set_debug_view(view);
            seen.push(draw(&gpu, &mut one, &camera, Some(&mask)).rgba);
        }
        for (index, picture) in seen.iter().enumerate() {
            assert!(!seen[..index].contains(picture), "view {index} equals an earlier one");
        }
        one.set_debug_view(DebugView::Picture);
        assert_eq!(draw(&gpu, &mut one, &camera, Some(&mask)).rgba, plain.rgba);
    }

    #[test]
    fn a_light_view_shows_its_plane_of_the_mask() {
        let gpu = gpu();
        let (scene, mask) = (floor_and_lights(), mask());
        let camera = camera(SIZE.0, SIZE.1);
        let mut one = renderer(&gpu, &scene, mask.shape());
        one.set_debug_view(DebugView::Light(1));
        let picture = draw(&gpu, &mut one, &camera, Some(&mask));
        let mut surfaces = 0;
        for (index, [red, _, blue, _]) in (0..).zip(picture.rgba.as_chunks::<4>().0) {
            // Yellow: lit. Blue: unlit. Black: no surface.
            if (*red, *blue) != (0, 0) {
                surfaces += 1;
                assert_eq!(red > blue, mask.get(1, index % SIZE.0, index / SIZE.0), "pixel {index}");
            }
        }
        assert!(surfaces > 500, "{surfaces}");
    }
}
