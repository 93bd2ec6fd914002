//! The alpha of MASK materials, as the tracers and the rasteriser's alpha test read it.

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
