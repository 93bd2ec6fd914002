//! The alpha of MASK materials, as the tracers and the rasteriser's alpha test read it: the factor's, the picture's and
//! the vertices' multiplied.

use super::{material::AlphaMode, types::Scene};

/// A picture's alpha channel at full size, in pixels.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AlphaPicture {
    pub width: u32,
    pub height: u32,
    /// One byte a pixel, row by row from the top.
    pub alpha: Vec<u8>,
}

impl Scene {
    /// Returns the alpha channel of a MASK material's base colour picture. `None` for other materials, and for those
    /// without a picture: their alpha is the factor's everywhere.
    #[must_use]
    pub fn alpha_picture(&self, material: u32) -> Option<AlphaPicture> {
        let material = self.materials.get(material as usize)?;
        let (AlphaMode::Mask { .. }, Some(texture)) = (material.alpha, material.base_color_texture) else {
            return None;
        };
        let image = self.images.get(texture.image as usize)?;
        let alpha = image.rgba.iter().skip(3).step_by(4).copied().collect();
        Some(AlphaPicture { width: image.width, height: image.height, alpha })
    }

    /// Returns a vertex's alpha, 0 to 1: 1 where vertices have no colours.
    #[must_use]
    pub fn vertex_alpha(&self, vertex: u32) -> f32 {
        self.colors.get(vertex as usize).map_or(1.0, |[_, _, _, alpha]| f32::from(*alpha) / f32::from(u16::MAX))
    }

    /// Returns whether some vertex of each material has an alpha below 1. Empty where vertices have no colours.
    #[must_use]
    pub fn vertex_alpha_materials(&self) -> Vec<bool> {
        if self.colors.is_empty() {
            return Vec::new();
        }
        let mut found = vec![false; self.materials.len()];
        for draw in &self.draws {
            let first = draw.first_triangle as usize;
            let triangles = self.triangles.get(first..first + draw.triangles as usize).unwrap_or_default();
            let fades = triangles.as_flattened().iter().any(|vertex| self.vertex_alpha(*vertex) < 1.0);
            if let Some(material) = found.get_mut(draw.material as usize) {
                *material |= fades;
            }
        }
        found
    }
}

#[cfg(test)]
mod tests {
    use crate::scene::check::tests::scene;

    #[test]
    fn only_masked_materials_with_a_picture_have_one() {
        let mut scene = scene();
        let picture = scene.alpha_picture(1).unwrap();
        assert_eq!((picture.width, picture.height), (2, 1));
        assert_eq!(picture.alpha, [0, 255]);
        assert_eq!(scene.alpha_picture(0), None);
        assert_eq!(scene.alpha_picture(9), None);
        scene.materials[1].base_color_texture = None;
        assert_eq!(scene.alpha_picture(1), None);
    }
}
