//! Where the shading shaders read the values that a draw's invocations share: the camera, the lights, a material.
//!
//! If a loop or a branch reads a uniform buffer, Mesa's software driver (22.3, Debian 12's) copies and compiles the
//! shader again at every bind and keeps each copy: gigabytes in minutes. It does so for no storage buffer. WGSL lays a
//! type out alike in both, so the bytes are the same.

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Uniforms {
    /// `var<uniform>`, as the WGSL files say.
    Uniform,
    /// `var<storage, read>`.
    Storage,
}

impl Uniforms {
    /// Storage buffers for software, uniform buffers for real GPUs.
    #[must_use]
    pub fn of(device_type: wgpu::DeviceType) -> Self {
        if device_type == wgpu::DeviceType::Cpu { Self::Storage } else { Self::Uniform }
    }

    /// Binding type of the buffers.
    #[must_use]
    pub fn binding(self) -> wgpu::BufferBindingType {
        match self {
            Self::Uniform => wgpu::BufferBindingType::Uniform,
            Self::Storage => wgpu::BufferBindingType::Storage { read_only: true },
        }
    }

    /// Usage that the buffers are created with.
    #[must_use]
    pub fn usage(self) -> wgpu::BufferUsages {
        match self {
            Self::Uniform => wgpu::BufferUsages::UNIFORM,
            Self::Storage => wgpu::BufferUsages::STORAGE,
        }
    }

    /// Declares the uniform buffers of a WGSL text.
    #[must_use]
    pub fn declare(self, wgsl: String) -> String {
        match self {
            Self::Uniform => wgsl,
            Self::Storage => wgsl.replace("var<uniform>", "var<storage, read>"),
        }
    }
}
