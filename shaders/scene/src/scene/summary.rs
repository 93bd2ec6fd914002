//! A scene's counts, in a few lines for people.

use std::fmt;

use glam::DVec3;

use super::types::{Image, LightKind, Scene};

#[derive(Debug, Clone, PartialEq)]
pub struct Summary {
    /// Of OPAQUE, MASK and BLEND materials.
    pub triangles: [u64; 3],
    pub vertices: u64,
    /// Mesh instances in the file.
    pub instances: u32,
    /// OPAQUE, MASK and BLEND.
    pub materials: [usize; 3],
    pub images: usize,
    /// Directional, point and spot.
    pub lights: [usize; 3],
    /// Lowest corner in world space, in metres.
    pub min_m: DVec3,
    /// Highest corner in world space, in metres.
    pub max_m: DVec3,
    /// World position of the local origin, in metres.
    pub origin_m: DVec3,
    pub memory_bytes: u64,
}

impl Scene {
    #[must_use]
    pub fn summary(&self) -> Summary {
        let (mut triangles, mut materials, mut lights) = ([0; 3], [0; 3], [0; 3]);
        for draw in &self.draws {
            if let Some(material) = self.materials.get(draw.material as usize) {
                triangles[material.alpha.order()] += u64::from(draw.triangles);
            }
        }
        for material in &self.materials {
            materials[material.alpha.order()] += 1;
        }
        for light in &self.lights {
            lights[match light.kind {
                LightKind::Directional => 0,
                LightKind::Point => 1,
                LightKind::Spot { .. } => 2,
            }] += 1;
        }
        Summary {
            triangles,
            vertices: self.positions.len() as u64,
            instances: self.instances,
            materials,
            images: self.images.len(),
            lights,
            min_m: self.origin_m + self.bounds.min.as_dvec3(),
            max_m: self.origin_m + self.bounds.max.as_dvec3(),
            origin_m: self.origin_m,
            memory_bytes: self.memory_bytes(),
        }
    }

    /// Returns the memory that the scene's arrays take, in bytes.
    #[must_use]
    pub fn memory_bytes(&self) -> u64 {
        let image = |image: &Image| size_of_val(image) + image.encoded.len() + image.rgba.len();
        let bytes = size_of_val(self)
            + size_of_val(&*self.positions)
            + size_of_val(&*self.normals)
            + size_of_val(&*self.uvs)
            + size_of_val(&*self.uvs_1)
            + size_of_val(&*self.tangents)
            + size_of_val(&*self.colors)
            + size_of_val(&*self.triangles)
            + size_of_val(&*self.draws)
            + size_of_val(&*self.materials)
            + size_of_val(&*self.lights)
            + size_of_val(&*self.cameras)
            + self.images.iter().map(image).sum::<usize>();
        bytes as u64
    }
}

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [opaque, mask, blend] = self.triangles;
        writeln!(f, "triangles   {} (OPAQUE {opaque}, MASK {mask}, BLEND {blend})", opaque + mask + blend)?;
        writeln!(f, "vertices    {}", self.vertices)?;
        writeln!(f, "instances   {}", self.instances)?;
        let [opaque, mask, blend] = self.materials;
        writeln!(f, "materials   {} (OPAQUE {opaque}, MASK {mask}, BLEND {blend})", opaque + mask + blend)?;
        writeln!(f, "pictures    {}", self.images)?;
        let [directional, point, spot] = self.lights;
        let lights = directional + point + spot;
        writeln!(f, "lights      {lights} (directional {directional}, point {point}, spot {spot})")?;
        // Scenes may be a tenth of a millimetre large.
        let decimals = if (self.max_m - self.min_m).max_element() < 0.1 { 7 } else { 3 };
        writeln!(f, "bounds      {:.decimals$} to {:.decimals$} m", self.min_m, self.max_m)?;
        writeln!(f, "origin      {} m", self.origin_m)?;
        write!(f, "memory      {:.1} MiB", self.memory_bytes as f64 / f64::from(1 << 20))
    }
}
