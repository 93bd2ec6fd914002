//! The scene on the adapter: vertices, indices, and one bind group for each material.

use std::collections::HashMap;

use glam::{Vec2, Vec3};
use gnomon_scene::{AlphaMode, Scene, Texture, Wrap};
use gnomon_shaders::{gpu::Gpu, shading::Material};
use rayon::prelude::*;
use wgpu::util::DeviceExt as _;

use super::{
    error::RenderError,
    pipeline::{bind_group, bind_group_layout, constant, picture, uniform},
    texture::{self, Srgb},
};

/// A vertex as the shaders read it.
#[repr(C)]
#[derive(Debug, Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Vertex {
    position: Vec3,
    normal: Vec3,
    uv: Vec2,
}

const ATTRIBUTES: [wgpu::VertexAttribute; 3] = wgpu::vertex_attr_array![0 => Float32x3, 1 => Float32x3, 2 => Float32x2];

pub(crate) const VERTEX_LAYOUT: wgpu::VertexBufferLayout<'static> = wgpu::VertexBufferLayout {
    array_stride: size_of::<Vertex>() as u64,
    step_mode: wgpu::VertexStepMode::Vertex,
    attributes: &ATTRIBUTES,
};

/// Triangles of one material, drawn together.
#[derive(Debug, Clone)]
pub(crate) struct Batch {
    pub(crate) material: usize,
    pub(crate) indices: std::ops::Range<u32>,
    pub(crate) alpha: AlphaMode,
    pub(crate) double_sided: bool,
    /// Centre of the triangles; blended batches are sorted by it.
    pub(crate) centre: Vec3,
}

#[derive(Debug)]
pub(crate) struct SceneUpload {
    pub(crate) vertices: wgpu::Buffer,
    pub(crate) indices: wgpu::Buffer,
    pub(crate) batches: Vec<Batch>,
    pub(crate) material_layout: wgpu::BindGroupLayout,
    /// One for each material of the scene.
    pub(crate) materials: Vec<wgpu::BindGroup>,
}

impl SceneUpload {
    pub(crate) fn new(gpu: &Gpu, scene: &Scene, anisotropy: u16) -> Result<Self, RenderError> {
        let device = &gpu.device;
        let limit = device.limits().max_buffer_size;
        let buffer = |what, bytes: &[u8], usage| {
            if bytes.len() as u64 > limit {
                return Err(RenderError::TooLarge { what, needed: bytes.len() as u64, limit });
            }
            // An empty scene still shows the sky, but an empty buffer cannot be bound.
            let contents = if bytes.is_empty() { &[0; size_of::<Vertex>()] } else { bytes };
            Ok(device.create_buffer_init(&wgpu::util::BufferInitDescriptor { label: Some(what), contents, usage }))
        };
        let vertices: Vec<Vertex> = (scene.positions.iter().zip(&scene.normals).zip(&scene.uvs))
            .map(|((position, normal), uv)| Vertex { position: *position, normal: *normal, uv: *uv })
            .collect();
        let material_layout = material_layout(gpu);
        Ok(Self {
            vertices: buffer("vertices", bytemuck::cast_slice(&vertices), wgpu::BufferUsages::VERTEX)?,
            indices: buffer("indices", bytemuck::cast_slice(&scene.triangles), wgpu::BufferUsages::INDEX)?,
            batches: batches(scene),
            materials: materials(gpu, scene, &material_layout, anisotropy)?,
            material_layout,
        })
    }
}

fn batches(scene: &Scene) -> Vec<Batch> {
    let mut batches: Vec<Batch> = Vec::new();
    for draw in scene.draws.iter().filter(|draw| draw.triangles > 0) {
        let material = &scene.materials[draw.material as usize];
        let indices = draw.first_triangle * 3..(draw.first_triangle + draw.triangles) * 3;
        if let Some(last) = batches.last_mut()
            && last.material == draw.material as usize
            && last.indices.end == indices.start
            && !matches!(last.alpha, AlphaMode::Blend)
        {
            last.indices.end = indices.end;
            continue;
        }
        let corners = &scene.triangles[draw.first_triangle as usize..][..draw.triangles as usize];
        let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
        for index in corners.as_flattened() {
            low = low.min(scene.positions[*index as usize]);
            high = high.max(scene.positions[*index as usize]);
        }
        batches.push(Batch {
            material: draw.material as usize,
            indices,
            alpha: material.alpha,
            double_sided: material.double_sided,
            centre: (low + high) * 0.5,
        });
    }
    batches
}

fn material_layout(gpu: &Gpu) -> wgpu::BindGroupLayout {
    let bindings = [
        uniform::<Material>(gpu),
        picture(wgpu::TextureSampleType::Float { filterable: true }),
        wgpu::BindingType::Sampler(wgpu::SamplerBindingType::Filtering),
    ];
    bind_group_layout(&gpu.device, "material", wgpu::ShaderStages::FRAGMENT, &bindings)
}

fn materials(
    gpu: &Gpu,
    scene: &Scene,
    layout: &wgpu::BindGroupLayout,
    anisotropy: u16,
) -> Result<Vec<wgpu::BindGroup>, RenderError> {
    let (device, queue) = (&gpu.device, &gpu.queue);
    let images = images(device, queue, scene)?;
    let white = texture::upload(device, queue, (1, 1), texture::WHITE.to_vec(), &[]);
    let mut samplers = HashMap::new();
    let groups = (0_u32..).zip(&scene.materials).map(|(index, material)| {
        let uniform = constant(gpu, "material", &Material::new(material, index));
        let texture = material.base_color_texture;
        let (wrap_u, wrap_v) = texture.map_or((Wrap::Repeat, Wrap::Repeat), |texture| (texture.wrap_u, texture.wrap_v));
        let modes = [wrap_u, wrap_v].map(address_mode);
        let sampler = samplers.entry(modes).or_insert_with(|| sampler(device, modes, anisotropy));
        let view = texture.and_then(|texture| images.get(&texture.image)).unwrap_or(&white);
        let resources = [
            uniform.as_entire_binding(),
            wgpu::BindingResource::TextureView(view),
            wgpu::BindingResource::Sampler(sampler),
        ];
        bind_group(device, "material", layout, &resources)
    });
    Ok(groups.collect())
}

/// Uploads every image that a material uses, with its mips. Each thread computes one image; a browser has one thread.
fn images(
    device: &wgpu::Device,
    queue: &wgpu::Queue,
    scene: &Scene,
) -> Result<HashMap<u32, wgpu::TextureView>, RenderError> {
    // True if some material reads the image's alpha: mips then weigh texels by it.
    let mut wanted: HashMap<u32, bool> = HashMap::new();
    for material in &scene.materials {
        if let Some(Texture { image, .. }) = material.base_color_texture {
            *wanted.entry(image).or_default() |= !matches!(material.alpha, AlphaMode::Opaque);
        }
    }
    let limit = device.limits().max_texture_dimension_2d;
    let mut wanted: Vec<(u32, bool)> = wanted.into_iter().collect();
    wanted.sort_unstable();
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
        let mips = |(image, weigh): &(u32, bool)| {
            let image = &scene.images[*image as usize];
            srgb.mips(&image.rgba, image.width, image.height, *weigh)
        };
        let made: Vec<Vec<u8>> = group.par_iter().map(mips).collect();
        for ((index, _), mips) in group.iter().zip(made) {
            let image = &scene.images[*index as usize];
            let view = texture::upload(device, queue, (image.width, image.height), image.rgba.clone(), &mips);
            views.insert(*index, view);
        }
        // Textures are written through staging memory, which only a submission frees.
        queue.submit([]);
    }
    Ok(views)
}

fn address_mode(wrap: Wrap) -> wgpu::AddressMode {
    match wrap {
        Wrap::Repeat => wgpu::AddressMode::Repeat,
        Wrap::MirroredRepeat => wgpu::AddressMode::MirrorRepeat,
        Wrap::ClampToEdge => wgpu::AddressMode::ClampToEdge,
    }
}

fn sampler(device: &wgpu::Device, [u, v]: [wgpu::AddressMode; 2], anisotropy: u16) -> wgpu::Sampler {
    device.create_sampler(&wgpu::SamplerDescriptor {
        label: Some("base colour"),
        address_mode_u: u,
        address_mode_v: v,
        mag_filter: wgpu::FilterMode::Linear,
        min_filter: wgpu::FilterMode::Linear,
        mipmap_filter: wgpu::MipmapFilterMode::Linear,
        anisotropy_clamp: anisotropy,
        ..wgpu::SamplerDescriptor::default()
    })
}
