//! Materials on the adapter: factors, textures and samplers, in one bind group for each.

use std::collections::HashMap;

use gnomon_scene::{AlphaMode, Filter, Material as SceneMaterial, Scene, Texture, Wrap};
use gnomon_shaders::{
    gpu::Gpu,
    material::{Finish, Material, more_textures},
};
use rayon::prelude::*;
use wgpu::util::DeviceExt as _;

use super::{
    error::RenderError,
    pipeline::{bind_group, bind_group_layout, constant, picture, uniform},
    texture::{self, Content, Srgb},
};

/// Exposed radiance of an emissive factor of 1. By the specification the factor is in cd/m², but files use it as paint:
/// beside lights of several thousand lux it would be black.
pub(crate) const EMISSIVE: f32 = 1.6;

/// What the texels of [`more_textures`] are.
const CONTENTS: [Content; 8] = [
    Content::Numbers,
    Content::Normals,
    Content::Numbers,
    Content::Color,
    Content::Numbers,
    Content::Normals,
    Content::Color,
    Content::Numbers,
];

/// The material's numbers; then a texture and a sampler for each binding of `surface.wgsl`.
pub(crate) fn layout(gpu: &Gpu) -> wgpu::BindGroupLayout {
    let mut bindings = vec![uniform::<Material>(gpu)];
    for _ in 0..=CONTENTS.len() {
        bindings.push(picture(wgpu::TextureSampleType::Float { filterable: true }));
        bindings.push(wgpu::BindingType::Sampler(wgpu::SamplerBindingType::Filtering));
    }
    bind_group_layout(&gpu.device, "material", wgpu::ShaderStages::FRAGMENT, &bindings)
}

pub(crate) fn finishes(gpu: &Gpu, scene: &Scene) -> wgpu::Buffer {
    let mut finishes: Vec<Finish> = scene.materials.iter().map(Finish::new).collect();
    // A binding cannot be empty.
    finishes.push(bytemuck::Zeroable::zeroed());
    gpu.device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
        label: Some("finishes"),
        contents: bytemuck::cast_slice(&finishes),
        usage: wgpu::BufferUsages::STORAGE,
    })
}

/// A material's textures in the order of their bindings, and what their texels are.
fn textures(material: &SceneMaterial) -> impl Iterator<Item = (Option<Texture>, Content)> {
    let color = if matches!(material.alpha, AlphaMode::Opaque) { Content::Color } else { Content::ColorByAlpha };
    std::iter::once((material.base_color_texture, color)).chain(more_textures(material).into_iter().zip(CONTENTS))
}

pub(crate) fn groups(
    gpu: &Gpu,
    scene: &Scene,
    layout: &wgpu::BindGroupLayout,
    anisotropy: u16,
) -> Result<Vec<wgpu::BindGroup>, RenderError> {
    let (device, queue) = (&gpu.device, &gpu.queue);
    let pictures = pictures(device, queue, scene)?;
    let white = texture::upload(device, queue, (1, 1), Content::Color, texture::WHITE.to_vec(), &[]);
    let mut samplers = HashMap::new();
    let groups = (0_u32..).zip(&scene.materials).map(|(index, material)| {
        let numbers = constant(gpu, "material", &Material::new(material, index, EMISSIVE));
        let bound: Vec<_> = textures(material)
            .map(|(texture, content)| {
                let modes = Modes::of(texture.as_ref());
                let sampler = samplers.entry(modes).or_insert_with(|| modes.sampler(device, anisotropy)).clone();
                let view = texture.and_then(|texture| find(&pictures, texture.image, content)).unwrap_or(&white);
                (view, sampler)
            })
            .collect();
        let pairs = bound.iter().flat_map(|(view, sampler)| {
            [wgpu::BindingResource::TextureView(view), wgpu::BindingResource::Sampler(sampler)]
        });
        let resources: Vec<_> = std::iter::once(numbers.as_entire_binding()).chain(pairs).collect();
        bind_group(device, "material", layout, &resources)
    });
    Ok(groups.collect())
}

type Pictures = HashMap<(u32, Content), wgpu::TextureView>;

/// A colour picture whose mips are weighed by alpha serves all.
fn find(pictures: &Pictures, image: u32, content: Content) -> Option<&wgpu::TextureView> {
    let weighed = (content == Content::Color).then(|| pictures.get(&(image, Content::ColorByAlpha))).flatten();
    weighed.or_else(|| pictures.get(&(image, content)))
}

/// Uploads every image that a material uses, with its mips, once for each meaning of its texels. Each thread computes
/// one image; a browser has one thread.
fn pictures(device: &wgpu::Device, queue: &wgpu::Queue, scene: &Scene) -> Result<Pictures, RenderError> {
    let used = scene.materials.iter().flat_map(textures);
    let mut wanted: Vec<(u32, Content)> = used.filter_map(|(texture, of)| texture.map(|t| (t.image, of))).collect();
    wanted.sort_unstable();
    wanted.dedup();
    let weighed: Vec<u32> =
        wanted.iter().filter(|(_, of)| *of == Content::ColorByAlpha).map(|(image, _)| *image).collect();
    wanted.retain(|(image, of)| *of != Content::Color || weighed.binary_search(image).is_err());
    let limit = device.limits().max_texture_dimension_2d;
    for (image, _) in &wanted {
        let image = &scene.images[*image as usize];
        let side = image.width.max(image.height);
        if side > limit {
            return Err(RenderError::TooLarge { what: "texture side", needed: side.into(), limit: limit.into() });
        }
    }
    let srgb = Srgb::new();
    let mut views = HashMap::new();
    // A few images at a time, to bound memory: at most one set of mips for each thread.
    for group in wanted.chunks(rayon::current_num_threads()) {
        let mips = |(image, content): &(u32, Content)| {
            let image = &scene.images[*image as usize];
            srgb.mips(&image.rgba, image.width, image.height, *content)
        };
        let made: Vec<Vec<u8>> = group.par_iter().map(mips).collect();
        for ((index, content), mips) in group.iter().zip(made) {
            let image = &scene.images[*index as usize];
            let size = (image.width, image.height);
            let view = texture::upload(device, queue, size, *content, image.rgba.clone(), &mips);
            views.insert((*index, *content), view);
        }
        // Textures are written through staging memory, which only a submission frees.
        queue.submit([]);
    }
    Ok(views)
}

/// How a texture is read between and outside its texels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
struct Modes {
    wraps: [Wrap; 2],
    magnified: Filter,
    minified: Filter,
    mips: Option<Filter>,
}

impl Modes {
    fn of(texture: Option<&Texture>) -> Self {
        let none = Texture::new(0, Wrap::Repeat, Wrap::Repeat);
        let texture = texture.unwrap_or(&none);
        Self {
            wraps: [texture.wrap_u, texture.wrap_v],
            magnified: texture.magnified,
            minified: texture.minified,
            mips: texture.mips,
        }
    }

    fn sampler(self, device: &wgpu::Device, anisotropy: u16) -> wgpu::Sampler {
        let [address_mode_u, address_mode_v] = self.wraps.map(address_mode);
        let smooth = [Some(self.magnified), Some(self.minified), self.mips] == [Some(Filter::Linear); 3];
        device.create_sampler(&wgpu::SamplerDescriptor {
            label: Some("texture"),
            address_mode_u,
            address_mode_v,
            mag_filter: filter(self.magnified),
            min_filter: filter(self.minified),
            mipmap_filter: match self.mips {
                Some(Filter::Linear) => wgpu::MipmapFilterMode::Linear,
                Some(Filter::Nearest) | None => wgpu::MipmapFilterMode::Nearest,
            },
            // Rounds to the full-size picture, but lets the adapter tell a reduced picture from an enlarged one.
            lod_max_clamp: if self.mips.is_some() { 32.0 } else { 0.25 },
            // Only smooth filters may be anisotropic (WebGPU).
            anisotropy_clamp: if smooth { anisotropy } else { 1 },
            ..wgpu::SamplerDescriptor::default()
        })
    }
}

fn address_mode(wrap: Wrap) -> wgpu::AddressMode {
    match wrap {
        Wrap::Repeat => wgpu::AddressMode::Repeat,
        Wrap::MirroredRepeat => wgpu::AddressMode::MirrorRepeat,
        Wrap::ClampToEdge => wgpu::AddressMode::ClampToEdge,
    }
}

fn filter(filter: Filter) -> wgpu::FilterMode {
    match filter {
        Filter::Nearest => wgpu::FilterMode::Nearest,
        Filter::Linear => wgpu::FilterMode::Linear,
    }
}
