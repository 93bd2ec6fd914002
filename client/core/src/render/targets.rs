//! The textures that the passes write and read, of the picture's size.

use super::put_off::PutOff;

/// sRGB-encoded.
pub const PICTURE_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8Unorm;
/// First colour target of the G-buffer: base colour and occlusion.
pub(crate) const COLOR: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8UnormSrgb;
/// Second colour target of the G-buffer: the packed surface (`packed_surface` of `gbuffer.wgsl`).
pub(crate) const NORMAL_MATERIAL: wgpu::TextureFormat = wgpu::TextureFormat::Rgba32Uint;
/// Predicted visibility; `predict.wgsl` defines its two words.
pub(crate) const VISIBILITY: wgpu::TextureFormat = wgpu::TextureFormat::Rg32Uint;
/// Reversed-Z depth, kept in [`super::predict::depth_history`].
pub(crate) const DEPTH: wgpu::TextureFormat = wgpu::TextureFormat::Depth32Float;
/// Light, before tone mapping. Also what surfaces emit, the G-buffer's third target.
pub(crate) const LIGHT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba16Float;

#[derive(Debug)]
pub(crate) struct Targets {
    pub(crate) width: u32,
    pub(crate) height: u32,
    pub(crate) color: wgpu::TextureView,
    pub(crate) normal_material: wgpu::TextureView,
    pub(crate) visibility: wgpu::TextureView,
    /// What surfaces emit, where some do.
    pub(crate) emitted: Option<wgpu::TextureView>,
    pub(crate) light: wgpu::TextureView,
    pub(crate) put_off: PutOff,
}

impl Targets {
    pub(crate) fn new(device: &wgpu::Device, (width, height): (u32, u32), emits: bool) -> Self {
        let picture = |label, format, usage| {
            let usage = usage | wgpu::TextureUsages::TEXTURE_BINDING;
            let usage = if format == LIGHT && !cfg!(test) { usage } else { usage | wgpu::TextureUsages::COPY_SRC };
            texture(device, label, (width, height), format, usage).create_view(&wgpu::TextureViewDescriptor::default())
        };
        let (drawn, computed) = (wgpu::TextureUsages::RENDER_ATTACHMENT, wgpu::TextureUsages::STORAGE_BINDING);
        Self {
            width,
            height,
            color: picture("base colour", COLOR, drawn),
            normal_material: picture("normal and material", NORMAL_MATERIAL, drawn),
            visibility: picture("visibility", VISIBILITY, computed),
            emitted: emits.then(|| picture("emitted light", LIGHT, drawn)),
            // Blended surfaces are drawn over it.
            light: picture("light", LIGHT, drawn | computed),
            put_off: PutOff::new(device, (width, height)),
        }
    }
}

pub fn texture(
    device: &wgpu::Device,
    label: &'static str,
    (width, height): (u32, u32),
    format: wgpu::TextureFormat,
    usage: wgpu::TextureUsages,
) -> wgpu::Texture {
    layered_texture(device, label, [width, height, 1], format, usage)
}

/// A texture of one mip level with this width, height and number of layers.
pub(crate) fn layered_texture(
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
