//! What every [`Scene`] guarantees, checked: after loading, and again by whoever receives one.

use std::f32::consts::FRAC_PI_2;

use glam::Vec3;
use thiserror::Error;

use super::{
    Aabb, AlphaMode, Image, Light, LightKind, Material, Scene,
    limits::{
        MAX_DRAWS, MAX_IMAGE_SIDE_PX, MAX_IMAGES, MAX_IMAGES_PIXELS, MAX_LIGHTS, MAX_MATERIALS, MAX_NAME_BYTES,
        MAX_TRIANGLES, MAX_VERTICES, in_reach, is_legal_uv,
    },
    normals::triangle_normal,
};

/// How far a unit vector's squared length may lie from 1: rounding to f32 moves it by less than 1e-6.
const UNIT_TOLERANCE: f32 = 1e-4;

/// The first guarantee of [`Scene`] that one does not keep.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("{0}")]
pub struct CheckError(String);

fn ensure(holds: bool, fault: impl FnOnce() -> String) -> Result<(), CheckError> {
    if holds { Ok(()) } else { Err(CheckError(fault())) }
}

/// Fails on the first element of which `holds` is not true.
fn all<T: std::fmt::Debug>(what: &str, elements: &[T], holds: impl Fn(&T) -> bool) -> Result<(), CheckError> {
    match elements.iter().enumerate().find(|(_, element)| !holds(element)) {
        Some((index, element)) => Err(CheckError(format!("{what} {index} is {element:?}"))),
        None => Ok(()),
    }
}

fn at_most(what: &str, count: usize, limit: u64) -> Result<(), CheckError> {
    ensure(count as u64 <= limit, || format!("{count} {what}, more than {limit}"))
}

/// Local coordinates are differences of two legal ones.
fn is_local(position: Vec3) -> bool {
    in_reach(position.as_dvec3() / 2.0)
}

fn is_unit(vector: Vec3) -> bool {
    (vector.length_squared() - 1.0).abs() <= UNIT_TOLERANCE
}

impl Scene {
    /// Checks everything that the type's documentation guarantees.
    ///
    /// # Errors
    /// On the first guarantee that is not kept.
    pub fn check(&self) -> Result<(), CheckError> {
        self.check_geometry()?;
        self.check_draws()?;
        at_most("materials", self.materials.len(), MAX_MATERIALS as u64 + 1)?;
        for (index, material) in self.materials.iter().enumerate() {
            self.check_material(index, material)?;
        }
        at_most("images", self.images.len(), MAX_IMAGES as u64)?;
        let pixels = |image: &Image| u64::from(image.width) * u64::from(image.height);
        let sides = 1..=MAX_IMAGE_SIDE_PX;
        for (index, image) in self.images.iter().enumerate() {
            let whole = sides.contains(&image.width)
                && sides.contains(&image.height)
                && image.rgba.len() as u64 == pixels(image) * 4;
            ensure(whole, || {
                format!("image {index} of {}×{} pixels has {} bytes", image.width, image.height, image.rgba.len())
            })?;
        }
        let pixels = self.images.iter().map(pixels).sum::<u64>();
        ensure(pixels <= MAX_IMAGES_PIXELS, || format!("{pixels} pixels, more than {MAX_IMAGES_PIXELS}"))?;
        ensure((1..=MAX_LIGHTS).contains(&self.lights.len()), || format!("{} lights", self.lights.len()))?;
        all("light", &self.lights, is_legal_light)
    }

    fn check_geometry(&self) -> Result<(), CheckError> {
        let vertices = self.positions.len();
        at_most("vertices", vertices, MAX_VERTICES)?;
        at_most("triangles", self.triangles.len(), MAX_TRIANGLES)?;
        ensure(!self.triangles.is_empty(), || "no triangles".to_owned())?;
        ensure(self.normals.len() == vertices && self.uvs.len() == vertices, || {
            format!("{vertices} positions, {} normals and {} UVs", self.normals.len(), self.uvs.len())
        })?;
        let origin = self.origin_m;
        ensure(in_reach(origin), || format!("the origin is {origin}"))?;
        all("position", &self.positions, |p| is_local(*p))?;
        all("normal", &self.normals, |normal| is_unit(*normal))?;
        all("UV", &self.uvs, |uv| is_legal_uv(*uv))?;
        all("triangle", &self.triangles, |corners| {
            let [a, b, c] = corners.map(|corner| self.positions.get(corner as usize).copied());
            a.zip(b).zip(c).is_some_and(|((a, b), c)| triangle_normal(a, b, c).is_some())
        })?;
        let bounds = Aabb::of(self);
        ensure(self.bounds == bounds, || format!("bounds are {:?}, but say {:?}", bounds, self.bounds))
    }

    fn check_draws(&self) -> Result<(), CheckError> {
        at_most("draws", self.draws.len(), MAX_DRAWS)?;
        ensure(self.instances > 0, || "no instances".to_owned())?;
        let (mut next, mut class) = (0_u64, 0);
        for (index, draw) in self.draws.iter().enumerate() {
            let of = match self.materials.get(draw.material as usize).map(|material| material.alpha) {
                Some(AlphaMode::Opaque) => 0,
                Some(AlphaMode::Mask { .. }) => 1,
                Some(AlphaMode::Blend) => 2,
                None => return Err(CheckError(format!("draw {index} names material {}", draw.material))),
            };
            let follows = u64::from(draw.first_triangle) == next && draw.triangles > 0 && of >= class;
            ensure(follows, || format!("draw {index} is {draw:?}, after triangle {next} of class {class}"))?;
            next += u64::from(draw.triangles);
            class = of;
        }
        let triangles = self.triangles.len();
        ensure(next == triangles as u64, || format!("draws cover {next} triangles of {triangles}"))
    }

    fn check_material(&self, index: usize, material: &Material) -> Result<(), CheckError> {
        let cutoff = match material.alpha {
            AlphaMode::Mask { cutoff } => cutoff,
            AlphaMode::Opaque | AlphaMode::Blend => 0.0,
        };
        let legal = material.base_color.to_array().iter().all(|v| (0.0..=1.0).contains(v))
            && material.emissive.to_array().iter().all(|v| *v >= 0.0 && v.is_finite())
            && cutoff >= 0.0
            && cutoff.is_finite()
            && material.name.len() <= MAX_NAME_BYTES
            && material.base_color_texture.is_none_or(|texture| (texture.image as usize) < self.images.len());
        ensure(legal, || format!("material {index} is {material:?}, with {} images", self.images.len()))
    }
}

fn is_legal_light(light: &Light) -> bool {
    let cone = match light.kind {
        LightKind::Directional | LightKind::Point => true,
        LightKind::Spot { inner_cone_rad, outer_cone_rad } => {
            inner_cone_rad >= 0.0 && inner_cone_rad <= outer_cone_rad && outer_cone_rad <= FRAC_PI_2 + 1e-6
        }
    };
    cone && is_local(light.position)
        && is_unit(light.direction)
        && light.color.to_array().iter().all(|v| *v >= 0.0 && v.is_finite())
        && light.intensity >= 0.0
        && light.intensity.is_finite()
        && light.range_m > 0.0
        && light.name.len() <= MAX_NAME_BYTES
}

impl Aabb {
    /// The bounds of a scene's triangles; all zeros when there are none, or where they name no vertex.
    pub(super) fn of(scene: &Scene) -> Self {
        let corners = scene.triangles.iter().flatten();
        let mut positions = corners.filter_map(|corner| scene.positions.get(*corner as usize));
        let Some(first) = positions.next() else { return Self { min: Vec3::ZERO, max: Vec3::ZERO } };
        let (min, max) =
            positions.fold((*first, *first), |(min, max), position| (min.min(*position), max.max(*position)));
        Self { min, max }
    }
}
