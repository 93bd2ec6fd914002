//! The pictures that the passes write and read: all of one size, made once.

/// What the G-buffer's first colour target holds: base colour.
pub const COLOR: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8UnormSrgb;
/// What its second one holds: packed shading normal; packed material and plane normal.
pub const NORMAL_MATERIAL: wgpu::TextureFormat = wgpu::TextureFormat::Rg32Uint;
/// What prediction finds: the lights that reach a pixel, and those that the client alone would say do.
pub const VISIBILITY: wgpu::TextureFormat = wgpu::TextureFormat::Rg32Uint;
/// Reversed-Z depth, kept in [`super::predict::depth_history`].
pub const DEPTH: wgpu::TextureFormat = wgpu::TextureFormat::Depth32Float;
/// Shaded light, before tone mapping.
pub const LIGHT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba16Float;

/// The pictures between the passes.
#[derive(Debug)]
pub struct Targets {
    pub width: u32,
    pub height: u32,
    pub color: wgpu::TextureView,
    pub normal_material: wgpu::TextureView,
    pub visibility: wgpu::TextureView,
    pub light: wgpu::TextureView,
}

impl Targets {
    pub fn new(device: &wgpu::Device, width: u32, height: u32) -> Self {
        let picture = |label, format| {
            let usage = wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::TEXTURE_BINDING;
            let usage = if format == LIGHT { usage } else { usage | wgpu::TextureUsages::COPY_SRC };
            texture(device, label, (width, height), format, usage).create_view(&wgpu::TextureViewDescriptor::default())
        };
        Self {
            width,
            height,
            color: picture("base colour", COLOR),
            normal_material: picture("normal and material", NORMAL_MATERIAL),
            visibility: picture("visibility", VISIBILITY),
            light: picture("light", LIGHT),
        }
    }
}

/// A texture of one level.
pub fn texture(
    device: &wgpu::Device,
    label: &'static str,
    (width, height): (u32, u32),
    format: wgpu::TextureFormat,
    usage: wgpu::TextureUsages,
) -> wgpu::Texture {
    layered_texture(device, label, [width, height, 1], format, usage)
}

/// A texture of one level and some layers: its width, height, and how many they are.
pub fn layered_texture(
    device: &wgpu::Device,
    label: &'static str,
    [width, height, depth_or_array_layers]: [u32; 3],
    format: wgpu::TextureFormat,
    usage: wgpu::TextureUsages,
) -> wgpu::Texture {
    device.create_texture(&wgpu::TextureDescriptor {
        label: Some(label),
        size: wgpu::Extent3d { width, height, depth_or_array_layers },
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format,
        usage,
        view_formats: &[],
    })
}
