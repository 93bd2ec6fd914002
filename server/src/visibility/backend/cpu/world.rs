//! All data that tracing reads.

use glam::Vec3;
use gnomon_scene::{AlphaMode, Scene};

use super::{alpha::Alpha, light::PreparedLight, surface::Corners};
use crate::visibility::{
    backend::BackendError,
    hierarchy::bvh::{TriangleFlags, WideBvh},
};

pub(super) struct World {
    pub(super) bvh: WideBvh,
    pub(super) corners: Vec<Corners>,
    pub(super) alpha: Alpha,
    pub(super) lights: Vec<PreparedLight>,
    /// The origin of parallel rays: the middle of the scene.
    pub(super) middle: Vec3,
    /// Bound on the distance of scene coordinates from the middle, even when sheared.
    pub(super) size_m: f32,
}

impl World {
    /// Builds the tree on the current rayon pool. Errors if the alpha picture of a MASK material is not decoded.
    pub(super) fn new(scene: &Scene) -> Result<Self, BackendError> {
        let flags = triangle_flags(scene);
        let middle = (scene.bounds.min + scene.bounds.max) * 0.5;
        let size_m = (scene.bounds.max - scene.bounds.min).max_element() * 2.0;
        Ok(Self {
            bvh: WideBvh::build(&scene.positions, scene.tracing_triangles(), &|t| flags[t as usize]),
            corners: Corners::of(scene),
            alpha: Alpha::new(scene)?,
            lights: scene.lights.iter().map(|light| PreparedLight::new(light, middle, size_m)).collect(),
            middle,
            size_m,
        })
    }
}

/// How each triangle's material treats rays.
fn triangle_flags(scene: &Scene) -> Vec<TriangleFlags> {
    let vertex_alpha = scene.vertex_alpha_materials();
    let mut flags = Vec::with_capacity(scene.tracing_triangles().len());
    for draw in &scene.draws {
        let material = &scene.materials[draw.material as usize];
        if material.alpha == AlphaMode::Blend {
            break;
        }
        // Without a picture or vertices that are see-through alpha is constant: a triangle that passes needs no test.
        let varies = material.base_color_texture.is_some()
            || vertex_alpha.get(draw.material as usize).is_some_and(|counts| *counts);
        let masked = matches!(material.alpha, AlphaMode::Mask { cutoff } if varies || material.base_color.w < cutoff);
        let of_draw = TriangleFlags { single_sided: !material.double_sided, masked };
        flags.extend(std::iter::repeat_n(of_draw, draw.triangles as usize));
    }
    flags
}
