//! Building blocks of the passes: bindings, uniform buffers, shader modules, pipelines for all pixels.

use gnomon_shaders::{gpu::Gpu, splice::splice_for};
use wgpu::util::DeviceExt as _;

use super::error::RenderError;

/// Errors if the adapter allows no texture with sides of this length.
pub(crate) fn check_side(device: &wgpu::Device, side: u32) -> Result<(), RenderError> {
    let limit = device.limits().max_texture_dimension_2d;
    if side > limit {
        return Err(RenderError::TooLarge { what: "picture side", needed: side.into(), limit: limit.into() });
    }
    Ok(())
}

/// Binding type of a uniform that holds one `T`, in the kind of buffer that suits the adapter.
pub(crate) fn uniform<T>(gpu: &Gpu) -> wgpu::BindingType {
    wgpu::BindingType::Buffer {
        ty: gpu.uniforms().binding(),
        has_dynamic_offset: false,
        min_binding_size: wgpu::BufferSize::new(size_of::<T>() as u64),
    }
}

/// The buffer of a [`uniform`] that never changes.
pub(crate) fn constant<T: bytemuck::NoUninit>(gpu: &Gpu, label: &'static str, value: &T) -> wgpu::Buffer {
    gpu.device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
        label: Some(label),
        contents: bytemuck::bytes_of(value),
        usage: gpu.uniforms().usage(),
    })
}

/// The buffer of a [`uniform`] that changes. A write takes a staging buffer, so equal values are not written again.
#[derive(Debug)]
pub(crate) struct Variable<T> {
    buffer: wgpu::Buffer,
    written: Option<T>,
}

impl<T: bytemuck::NoUninit> Variable<T> {
    pub(crate) fn new(gpu: &Gpu, label: &'static str) -> Self {
        let buffer = gpu.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(label),
            size: size_of::<T>() as u64,
            usage: gpu.uniforms().usage() | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        Self { buffer, written: None }
    }

    pub(crate) fn buffer(&self) -> &wgpu::Buffer {
        &self.buffer
    }

    /// Sets the value that the next submissions read.
    pub(crate) fn set(&mut self, queue: &wgpu::Queue, value: T) {
        let bytes = bytemuck::bytes_of(&value);
        if self.written.as_ref().is_none_or(|written| bytemuck::bytes_of(written) != bytes) {
            queue.write_buffer(&self.buffer, 0, bytes);
            self.written = Some(value);
        }
    }
}

/// Makes the shader module of `wgsl/{path}`.
pub(crate) fn shader(gpu: &Gpu, path: &'static str) -> Result<wgpu::ShaderModule, RenderError> {
    let text = splice_for(gpu.uniforms(), path)?;
    let source = wgpu::ShaderSource::Wgsl(text.into());
    Ok(gpu.device.create_shader_module(wgpu::ShaderModuleDescriptor { label: Some(path), source }))
}

/// A pipeline that covers the picture with one triangle and has one target.
pub(crate) fn covering_pipeline(
    device: &wgpu::Device,
    module: &wgpu::ShaderModule,
    layouts: &[&wgpu::BindGroupLayout],
    fragment: &'static str,
    format: wgpu::TextureFormat,
) -> wgpu::RenderPipeline {
    covering_pipeline_with(device, module, layouts, (fragment, &[]), format.into())
}

/// [`covering_pipeline`] with values for the fragment shader's overrides, and any target.
pub(crate) fn covering_pipeline_with(
    device: &wgpu::Device,
    module: &wgpu::ShaderModule,
    layouts: &[&wgpu::BindGroupLayout],
    (fragment, constants): (&'static str, &[(&str, f64)]),
    target: wgpu::ColorTargetState,
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
            targets: &[Some(target)],
        }),
        multiview_mask: None,
        cache: None,
    })
}

/// A compute pipeline with values for the shader's overrides.
pub(crate) fn compute_pipeline(
    device: &wgpu::Device,
    module: &wgpu::ShaderModule,
    layouts: &[&wgpu::BindGroupLayout],
    (entry, constants): (&'static str, &[(&str, f64)]),
) -> wgpu::ComputePipeline {
    let groups: Vec<_> = layouts.iter().copied().map(Some).collect();
    let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label: Some(entry),
        bind_group_layouts: &groups,
        immediate_size: 0,
    });
    device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
        label: Some(entry),
        layout: Some(&layout),
        module,
        entry_point: Some(entry),
        compilation_options: wgpu::PipelineCompilationOptions {
            constants,
            ..wgpu::PipelineCompilationOptions::default()
        },
        cache: None,
    })
}

/// A compute pass of one dispatch. Groups are numbered in order.
pub(crate) fn compute(
    encoder: &mut wgpu::CommandEncoder,
    label: &'static str,
    pipeline: &wgpu::ComputePipeline,
    groups: &[&wgpu::BindGroup],
    dispatch: impl FnOnce(&mut wgpu::ComputePass<'_>),
) {
    let mut pass =
        encoder.begin_compute_pass(&wgpu::ComputePassDescriptor { label: Some(label), timestamp_writes: None });
    pass.set_pipeline(pipeline);
    (0..).zip(groups).for_each(|(place, group)| pass.set_bind_group(place, *group, &[]));
    dispatch(&mut pass);
}

/// Side of a workgroup of the passes that take a pixel an invocation.
const WORKGROUP_PX: u32 = 8;

/// One invocation for each pixel.
pub(crate) fn dispatch_pixels(pass: &mut wgpu::ComputePass<'_>, (width, height): (u32, u32)) {
    pass.dispatch_workgroups(width.div_ceil(WORKGROUP_PX), height.div_ceil(WORKGROUP_PX), 1);
}

/// A colour attachment that is cleared to zero.
pub(crate) fn cleared(view: &wgpu::TextureView) -> Option<wgpu::RenderPassColorAttachment<'_>> {
    Some(wgpu::RenderPassColorAttachment {
        view,
        depth_slice: None,
        resolve_target: None,
        ops: wgpu::Operations { load: wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT), store: wgpu::StoreOp::Store },
    })
}

/// A colour attachment that is drawn over.
pub(crate) fn kept(view: &wgpu::TextureView) -> Option<wgpu::RenderPassColorAttachment<'_>> {
    Some(wgpu::RenderPassColorAttachment {
        view,
        depth_slice: None,
        resolve_target: None,
        ops: wgpu::Operations { load: wgpu::LoadOp::Load, store: wgpu::StoreOp::Store },
    })
}

/// Binding type of a single-sampled 2D texture.
pub(crate) fn picture(sample_type: wgpu::TextureSampleType) -> wgpu::BindingType {
    wgpu::BindingType::Texture { sample_type, view_dimension: wgpu::TextureViewDimension::D2, multisampled: false }
}

/// Binding type of a 2D texture that a compute pass writes.
pub(crate) fn written_picture(format: wgpu::TextureFormat) -> wgpu::BindingType {
    wgpu::BindingType::StorageTexture {
        access: wgpu::StorageTextureAccess::WriteOnly,
        format,
        view_dimension: wgpu::TextureViewDimension::D2,
    }
}

pub(crate) const fn storage(read_only: bool) -> wgpu::BindingType {
    wgpu::BindingType::Buffer {
        ty: wgpu::BufferBindingType::Storage { read_only },
        has_dynamic_offset: false,
        min_binding_size: None,
    }
}

/// Bindings are numbered in order.
pub(crate) fn bind_group_layout(
    device: &wgpu::Device,
    label: &'static str,
    visibility: wgpu::ShaderStages,
    bindings: &[wgpu::BindingType],
) -> wgpu::BindGroupLayout {
    let entries: Vec<_> = (0..)
        .zip(bindings)
        .map(|(binding, ty)| wgpu::BindGroupLayoutEntry { binding, visibility, ty: *ty, count: None })
        .collect();
    device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some(label), entries: &entries })
}

/// Bindings are numbered in order.
pub(crate) fn bind_group(
    device: &wgpu::Device,
    label: &'static str,
    layout: &wgpu::BindGroupLayout,
    resources: &[wgpu::BindingResource<'_>],
) -> wgpu::BindGroup {
    let entries: Vec<_> = (0..)
        .zip(resources)
        .map(|(binding, resource)| wgpu::BindGroupEntry { binding, resource: resource.clone() })
        .collect();
    device.create_bind_group(&wgpu::BindGroupDescriptor { label: Some(label), layout, entries: &entries })
}
