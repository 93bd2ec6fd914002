//! The pipelines of `predict.wgsl`, each compiled when it is first needed.

use std::collections::HashMap;

use crate::render::pipeline::compute_pipeline;

/// What a pipeline is compiled for. `layered`: several masks, or a partial one. `moved`: something has, since.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) enum Kernel {
    WithoutMask,
    /// One complete mask of the picture's own view, at a visibility share of 1.
    OwnView,
    /// Puts off pixels that take long.
    First {
        layered: bool,
        moved: bool,
    },
    /// Does every pixel, or those put off.
    Every {
        layered: bool,
        moved: bool,
    },
}

#[derive(Debug)]
pub(super) struct Kernels {
    module: wgpu::ShaderModule,
    layouts: [wgpu::BindGroupLayout; 3],
    compiled: HashMap<Kernel, wgpu::ComputePipeline>,
}

impl Kernels {
    pub(super) fn new(module: wgpu::ShaderModule, layouts: [wgpu::BindGroupLayout; 3]) -> Self {
        Self { module, layouts, compiled: HashMap::new() }
    }

    pub(super) fn get(&mut self, device: &wgpu::Device, kernel: Kernel) -> wgpu::ComputePipeline {
        let compile = || {
            let on = |on: bool| f64::from(u8::from(on));
            let (layered, moved) = match kernel {
                Kernel::First { layered, moved } | Kernel::Every { layered, moved } => (layered, moved),
                Kernel::WithoutMask | Kernel::OwnView => (false, false),
            };
            let constants = [
                ("layered", on(layered)),
                ("moved", on(moved)),
                ("puts_off", on(matches!(kernel, Kernel::First { .. } | Kernel::OwnView))),
                ("masks", on(kernel != Kernel::WithoutMask)),
                ("from_elsewhere", on(kernel != Kernel::OwnView)),
            ];
            let [scene, surfaces, masks] = &self.layouts;
            compute_pipeline(device, &self.module, &[scene, surfaces, masks], ("predict", &constants))
        };
        self.compiled.entry(kernel).or_insert_with(compile).clone()
    }
}
