//! Looks behind the picture: what the passes know of each pixel, in place of what it looks like.

use std::fmt;

use bytemuck::{Pod, Zeroable};
use gnomon_protocol::limits::MAX_LAYERS;
use gnomon_shaders::shading::View;
use serde::{Deserialize, Serialize};

use super::{
    RenderError, cleared, covering_pipeline, predict::depth_history::DepthHistory, shader, targets::Targets, uniform,
};

/// What is shown.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub enum DebugView {
    /// The picture.
    #[default]
    Picture,
    /// Where a light reaches, as the picture is shaded with it.
    Light(u32),
    /// Pixels that the mask says nothing of, while received visibility counts fully.
    Unknown,
    /// The same, and how many frames old the masks are that told of the others.
    Age {
        /// Frames that each mask is older than the picture, the newest first.
        lags: [u32; MAX_LAYERS],
    },
    /// Distance along the view.
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

/// Twin of `Choice` in `debug_view.wgsl`.
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

/// The pass, which stands in the tone pass's place.
#[derive(Debug)]
pub(crate) struct DebugPass {
    layout: wgpu::BindGroupLayout,
    view: wgpu::Buffer,
    choice: wgpu::Buffer,
    /// By the place of the picture's depth in the history.
    groups: Vec<wgpu::BindGroup>,
    pipeline: wgpu::RenderPipeline,
}

impl DebugPass {
    pub(crate) fn new(
        device: &wgpu::Device,
        view: &wgpu::Buffer,
        targets: &Targets,
        history: &DepthHistory,
        format: wgpu::TextureFormat,
    ) -> Result<Self, RenderError> {
        let layout = layout(device);
        let choice = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("debug view"),
            size: size_of::<Choice>() as u64,
            usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let module = shader(device, "shading/debug_view.wgsl")?;
        let pipeline = covering_pipeline(device, &module, &[&layout], "look", format);
        let mut pass = Self { layout, view: view.clone(), choice, groups: Vec::new(), pipeline };
        pass.resize(device, targets, history);
        Ok(pass)
    }

    /// Goes on with pictures of another size.
    pub(crate) fn resize(&mut self, device: &wgpu::Device, targets: &Targets, history: &DepthHistory) {
        let picture = wgpu::BindingResource::TextureView;
        let group = |depth| {
            let resources = [
                self.view.as_entire_binding(),
                self.choice.as_entire_binding(),
                picture(&targets.visibility),
                picture(depth),
                picture(&targets.normal_material),
            ];
            let entries: Vec<_> =
                (0..).zip(resources).map(|(binding, resource)| wgpu::BindGroupEntry { binding, resource }).collect();
            device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some("debug view"),
                layout: &self.layout,
                entries: &entries,
            })
        };
        self.groups = history.views().map(group).collect();
    }

    pub(crate) fn encode(
        &self,
        queue: &wgpu::Queue,
        encoder: &mut wgpu::CommandEncoder,
        view: DebugView,
        history: &DepthHistory,
        target: &wgpu::TextureView,
    ) {
        queue.write_buffer(&self.choice, 0, bytemuck::bytes_of(&Choice::from(view)));
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("debug view"),
            color_attachments: &[cleared(target)],
            ..wgpu::RenderPassDescriptor::default()
        });
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &self.groups[history.current()], &[]);
        pass.draw(0..3, 0..1);
    }
}

fn layout(device: &wgpu::Device) -> wgpu::BindGroupLayout {
    let picture = |sample_type| wgpu::BindingType::Texture {
        sample_type,
        view_dimension: wgpu::TextureViewDimension::D2,
        multisampled: false,
    };
    let bindings = [
        uniform::<View>(),
        uniform::<Choice>(),
        picture(wgpu::TextureSampleType::Uint),
        picture(wgpu::TextureSampleType::Depth),
        picture(wgpu::TextureSampleType::Uint),
    ];
    let entries: Vec<_> = (0..)
        .zip(bindings)
        .map(|(binding, ty)| wgpu::BindGroupLayoutEntry {
            binding,
            visibility: wgpu::ShaderStages::FRAGMENT,
            ty,
            count: None,
        })
        .collect();
    device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some("debug view"), entries: &entries })
}
