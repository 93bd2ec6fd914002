//! The alpha of MASK materials, as both back ends' tracers and the rasteriser's alpha test read it.

use super::{AlphaMode, Scene, Wrap};

/// A picture's alpha channel at full size.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AlphaPicture {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// One byte a pixel, row by row from the top.
    pub alpha: Vec<u8>,
}

impl Scene {
    /// The alpha channel of a MASK material's base colour picture. None for other materials, and for those without a
    /// picture: their alpha is the factor's everywhere.
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

impl Wrap {
    /// The texel that stands for texel `index` of a side of `size` texels.
    ///
    /// `size` must not be 0, nor above [`super::limits::MAX_IMAGE_SIDE_PX`].
    #[must_use]
    #[expect(
        clippy::cast_possible_wrap,
        clippy::cast_sign_loss,
        reason = "sizes are small, and remainders not negative"
    )]
    pub fn texel(self, index: i32, size: u32) -> u32 {
        let size = size as i32;
        (match self {
            Self::Repeat => index.rem_euclid(size),
            Self::MirroredRepeat => {
                let at = index.rem_euclid(2 * size);
                at.min(2 * size - 1 - at)
            }
            Self::ClampToEdge => index.clamp(0, size - 1),
        }) as u32
    }
}
