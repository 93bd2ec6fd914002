//! Pixels that a pass leaves to a second dispatch (`put_off.wgsl`).

use wgpu::util::DeviceExt as _;

use super::pipeline::{compute, dispatch_pixels, storage};

/// Workgroups in a row of the second dispatch. Twin of `COLUMNS` in `put_off.wgsl`.
const COLUMNS: u32 = 16;

/// Bytes of the list's head: rows and count.
const HEAD_BYTES: u64 = 8;

/// The list, and the arguments of the dispatch that does its pixels. One pass after the other uses it.
#[derive(Debug)]
pub(crate) struct PutOff {
    size: (u32, u32),
    list: wgpu::Buffer,
    /// A buffer cannot be written and give arguments in one dispatch.
    arguments: wgpu::Buffer,
}

impl PutOff {
    pub(crate) fn new(device: &wgpu::Device, (width, height): (u32, u32)) -> Self {
        let list = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("pixels put off"),
            size: HEAD_BYTES + u64::from(width) * u64::from(height) * 4,
            usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let arguments = device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
            label: Some("dispatch of pixels put off"),
            contents: bytemuck::cast_slice(&[COLUMNS, 0, 1]),
            usage: wgpu::BufferUsages::INDIRECT | wgpu::BufferUsages::COPY_DST,
        });
        Self { size: (width, height), list, arguments }
    }

    pub(crate) const fn layout() -> wgpu::BindingType {
        storage(false)
    }

    pub(crate) fn binding(&self) -> wgpu::BindingResource<'_> {
        self.list.as_entire_binding()
    }

    /// Runs a pass over the picture. Its groups bind the list. With `first`, that pipeline does most pixels and puts
    /// off some, which `every` does then; without, `every` does all.
    pub(crate) fn run(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        label: &'static str,
        (first, every): (Option<&wgpu::ComputePipeline>, &wgpu::ComputePipeline),
        groups: &[&wgpu::BindGroup],
    ) {
        encoder.clear_buffer(&self.list, 0, Some(HEAD_BYTES));
        let all = |pass: &mut wgpu::ComputePass<'_>| dispatch_pixels(pass, self.size);
        compute(encoder, label, first.unwrap_or(every), groups, all);
        if first.is_some() {
            encoder.copy_buffer_to_buffer(&self.list, 0, &self.arguments, 4, 4);
            compute(encoder, label, every, groups, |pass| pass.dispatch_workgroups_indirect(&self.arguments, 0));
        }
    }
}
