//! Light around the scene: what stands behind everything, what arrives from all sides, and what surfaces mirror of it.
//!
//! [`sky`] computes a sky from the scene's suns. A panorama can stand for it. Either becomes a [`cube`] of radiance
//! with levels for roughness, and [`harmonics`] for matt surfaces, made once. Lamps add an even light from everywhere,
//! in proportion to what they give. Server and masks know nothing of it.

mod cube;
mod harmonics;
mod packed;
mod panorama;
mod sky;

use std::sync::Arc;

use glam::{Vec3, Vec4};
use gnomon_scene::Light;
use gnomon_shaders::{gpu::Gpu, shading::Lighting};
use wgpu::util::DeviceExt as _;

use self::{
    cube::Cube,
    harmonics::{Harmonics, irradiance, project},
};
use super::{
    exposure::Exposure,
    survey::{Survey, power_of_lamps},
};

pub use panorama::{MAX_PIXELS, Panorama, PanoramaError};

/// Side of a computed sky's faces, in texels: it is smooth.
const SKY_SIDE: usize = 64;

/// Levels of a cube: roughness 0, 1/5, … 1. Twin: `ROUGHEST` in `environment.wgsl`.
const LEVELS: usize = 6;

/// Irradiance from above and below that goes with a typical irradiance of 1: shadows are dark but legible.
const AMBIENT_ABOVE: Vec3 = Vec3::new(0.165, 0.178, 0.205);
const AMBIENT_BELOW: Vec3 = Vec3::new(0.095, 0.087, 0.078);

/// Exposed radiance of the flat sky.
const FLAT_ZENITH: Vec3 = Vec3::new(0.20, 0.37, 0.72);
const FLAT_HORIZON: Vec3 = Vec3::new(0.78, 0.86, 0.95);

/// The sky is seen brighter than it lights: as dark as a clear one is beside sunlit white, it would look dull.
const SKY_SEEN: f32 = 1.6;

/// A panorama has no unit: its light from above is this share of the scene's typical irradiance.
const PANORAMA_SHARE: f32 = 0.4;

#[derive(Debug, Clone, Default)]
pub enum Environment {
    /// Even light from above and below, a painted sky, nothing to mirror.
    #[default]
    Flat,
    /// A sky computed from the lights, and what lamps scatter.
    Sky,
    /// Black.
    None,
    Panorama(Arc<Panorama>),
}

impl Environment {
    /// Whether what is behind the scene has the same brightness at any exposure.
    pub(crate) fn is_painted(&self) -> bool {
        matches!(self, Self::Flat | Self::None)
    }
}

/// The environment of a scene on the adapter.
#[derive(Debug)]
pub(crate) struct Surroundings {
    pub(crate) environment: Environment,
    pub(crate) view: wgpu::TextureView,
    pub(crate) sampler: wgpu::Sampler,
    harmonics: Harmonics,
    survey: Survey,
    /// What the sky was made of.
    suns: Vec<Vec4>,
}

impl Surroundings {
    pub(crate) fn new(gpu: &Gpu, environment: Environment, survey: Survey, lights: &[Light]) -> Self {
        let (harmonics, view) = made(gpu, &environment, lights);
        let sampler = gpu.device.create_sampler(&wgpu::SamplerDescriptor {
            label: Some("environment"),
            mag_filter: wgpu::FilterMode::Linear,
            min_filter: wgpu::FilterMode::Linear,
            mipmap_filter: wgpu::MipmapFilterMode::Linear,
            ..wgpu::SamplerDescriptor::default()
        });
        Self { environment, view, sampler, harmonics, survey, suns: sky::rough(lights) }
    }

    /// Takes the lights of another time. Returns whether the sky is another one, so that [`Self::view`] is new: if a
    /// sun has turned or changed by more than eyes notice.
    pub(crate) fn follow(&mut self, gpu: &Gpu, lights: &[Light]) -> bool {
        let suns = sky::rough(lights);
        let is_other = matches!(self.environment, Environment::Sky) && self.suns != suns;
        if is_other {
            self.suns = suns;
            (self.harmonics, self.view) = made(gpu, &self.environment, lights);
        }
        is_other
    }

    pub(crate) fn survey(&self) -> Survey {
        self.survey
    }

    /// Writes the light around to `lighting`. It shows `lights` with `exposure`; bit k of `on` is 1 if light k is on.
    pub(crate) fn light(&self, lighting: &mut Lighting, lights: &[Light], on: u32, exposure: Exposure) {
        let (mut sky_gain, mut seen, mut daylight) = (0.0, 1.0, 1.0);
        match &self.environment {
            Environment::None => {}
            Environment::Flat => {
                let ambient = exposure.reference_lux * exposure.scale;
                lighting.ambient_above = AMBIENT_ABOVE * ambient;
                lighting.ambient_below = AMBIENT_BELOW * ambient;
                lighting.zenith = FLAT_ZENITH;
                lighting.horizon = FLAT_HORIZON;
            }
            Environment::Sky => {
                let shining = lights.iter().enumerate().filter(|(k, _)| on & (1 << k) != 0).map(|(_, light)| light);
                sky_gain = sky::sun_lux(shining) * exposure.scale;
                (seen, daylight) = (SKY_SEEN, self.survey.daylight);
                let lamps = self.survey.lamp_lux * self.share_of_lamps(lights, on) * exposure.scale;
                lighting.ambient_above = AMBIENT_ABOVE * lamps;
                lighting.ambient_below = AMBIENT_BELOW * lamps;
                lighting.mirrored = 1.0;
            }
            Environment::Panorama(_) => {
                let above = irradiance(&self.harmonics, Vec3::Y).element_sum() / 3.0;
                let typical = self.survey.lux * exposure.scale;
                sky_gain = if above > 0.0 { PANORAMA_SHARE * typical / above } else { 0.0 };
            }
        }
        lighting.sky_seen = sky_gain * seen;
        lighting.sky_lit = sky_gain * daylight;
        lighting.harmonics = self.harmonics.map(|factor| Vec4::from((factor * lighting.sky_lit, 0.0)));
    }

    /// Share of the lamps' surveyed light that shines.
    fn share_of_lamps(&self, lights: &[Light], on: u32) -> f32 {
        if self.survey.lamps > 0.0 { power_of_lamps(lights, on) / self.survey.lamps } else { 0.0 }
    }
}

/// Makes what an environment gives matt surfaces, and what others mirror of it.
fn made(gpu: &Gpu, environment: &Environment, lights: &[Light]) -> (Harmonics, wgpu::TextureView) {
    let (cube, levels) = match environment {
        Environment::Flat | Environment::None => (Cube::black(), 1),
        Environment::Sky if sky::sun_lux(lights) == 0.0 => (Cube::black(), 1),
        Environment::Sky => (Cube::new(SKY_SIDE, sky::radiance(lights)), LEVELS),
        Environment::Panorama(panorama) => (panorama.cube(), LEVELS),
    };
    (project(&cube), upload(gpu, &cube.mirrored(levels)))
}

/// Uploads a cube's levels, the largest first.
fn upload(gpu: &Gpu, levels: &[Cube]) -> wgpu::TextureView {
    let side = u32::try_from(levels[0].side).unwrap_or(1);
    // Face by face, each with all its levels.
    let texels: Vec<u32> = (0..6)
        .flat_map(|face| {
            levels.iter().flat_map(move |cube| {
                let area = cube.side * cube.side;
                cube.texels[face * area..(face + 1) * area].iter().map(|radiance| packed::rgb9e5(*radiance))
            })
        })
        .collect();
    let texture = gpu.device.create_texture_with_data(
        &gpu.queue,
        &wgpu::TextureDescriptor {
            label: Some("environment"),
            size: wgpu::Extent3d { width: side, height: side, depth_or_array_layers: 6 },
            mip_level_count: u32::try_from(levels.len()).unwrap_or(1),
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: wgpu::TextureFormat::Rgb9e5Ufloat,
            usage: wgpu::TextureUsages::TEXTURE_BINDING,
            view_formats: &[],
        },
        wgpu::util::TextureDataOrder::LayerMajor,
        bytemuck::cast_slice(&texels),
    );
    texture.create_view(&wgpu::TextureViewDescriptor {
        dimension: Some(wgpu::TextureViewDimension::Cube),
        ..wgpu::TextureViewDescriptor::default()
    })
}

#[cfg(test)]
mod tests;
