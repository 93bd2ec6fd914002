//! An equirectangular picture of all directions: its middle column lies along −z, its top row is the zenith.

use std::f32::consts::{PI, TAU};

use glam::Vec3;
use thiserror::Error;

use super::{cube::Cube, packed};

/// Most pixels of a panorama: 8192 × 4096.
pub const MAX_PIXELS: u32 = 1 << 25;

/// Side of the faces, in texels.
const SIDE: usize = 256;

#[derive(Debug, Clone, PartialEq)]
pub struct Panorama {
    width: u32,
    height: u32,
    /// Linear RGB radiance, row by row from the top, each 0 to the largest that a texture holds.
    pixels: Vec<Vec3>,
}

#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum PanoramaError {
    #[error("the environment is {0}×{1} pixels: at most {MAX_PIXELS} pixels in all are allowed, and at least one")]
    Size(u32, u32),
    #[error("the environment has {0} pixels, not {1}×{2}")]
    Length(usize, u32, u32),
}

impl Panorama {
    /// Takes linear RGB, row by row from the top. What is no number counts as black.
    ///
    /// # Errors
    /// If there are too many pixels, or not as many as the sides say.
    pub fn new(width: u32, height: u32, mut pixels: Vec<Vec3>) -> Result<Self, PanoramaError> {
        let count = width.checked_mul(height).filter(|count| (1..=MAX_PIXELS).contains(count));
        let count = count.ok_or(PanoramaError::Size(width, height))?;
        if pixels.len() != count as usize {
            return Err(PanoramaError::Length(pixels.len(), width, height));
        }
        for pixel in &mut pixels {
            let known = |value: f32| if value.is_nan() { 0.0 } else { value.clamp(0.0, packed::MOST) };
            *pixel = Vec3::from_array(pixel.to_array().map(known));
        }
        Ok(Self { width, height, pixels })
    }

    pub(super) fn cube(&self) -> Cube {
        // A face spans a quarter of the width; each texel averages the pixels that it covers.
        let across = (self.width as usize).div_ceil(4 * SIDE).clamp(1, 8);
        #[expect(clippy::cast_precision_loss, reason = "a few")]
        let step = 1.0 / across as f32;
        #[expect(clippy::cast_precision_loss, reason = "sides are far below 2²⁴")]
        let width = 2.0 / SIDE as f32;
        Cube::new(SIDE, |direction| {
            let (right, up) = direction.any_orthonormal_pair();
            let mut sum = Vec3::ZERO;
            for place in 0..across * across {
                #[expect(clippy::cast_precision_loss, reason = "a few")]
                let offset = |i: usize| ((i as f32 + 0.5) * step - 0.5) * width;
                let aside = right * offset(place % across) + up * offset(place / across);
                sum += self.read((direction + aside).normalize());
            }
            #[expect(clippy::cast_precision_loss, reason = "a few")]
            let count = (across * across) as f32;
            sum / count
        })
    }

    /// Reads the four pixels around a direction, a unit vector.
    fn read(&self, direction: Vec3) -> Vec3 {
        #[expect(clippy::cast_precision_loss, reason = "sides are below 2²⁴ unless the picture is a line")]
        let (width, height) = (self.width as f32, self.height as f32);
        let x = (direction.x.atan2(-direction.z) / TAU + 0.5) * width - 0.5;
        let y = (direction.y.clamp(-1.0, 1.0).acos() / PI * height - 0.5).clamp(0.0, height - 1.0);
        #[expect(clippy::cast_possible_truncation, reason = "within the picture")]
        let (left, top) = (x.floor() as i64, y.floor() as i64);
        let at = |x: i64, y: i64| {
            let column = x.rem_euclid(i64::from(self.width));
            let row = y.min(i64::from(self.height) - 1);
            let place = usize::try_from(row * i64::from(self.width) + column).unwrap_or(0);
            self.pixels.get(place).copied().unwrap_or(Vec3::ZERO)
        };
        let (across, down) = (x - x.floor(), y - y.floor());
        let upper = at(left, top).lerp(at(left + 1, top), across);
        upper.lerp(at(left, top + 1).lerp(at(left + 1, top + 1), across), down)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn directions_lie_where_the_format_says() {
        let (width, height) = (64_u16, 32_u16);
        let pixel = |x: u16, y: u16| Vec3::new(f32::from(x), f32::from(y), 0.0);
        let pixels = (0..width * height).map(|place| pixel(place % width, place / width)).collect();
        let panorama = Panorama::new(width.into(), height.into(), pixels).unwrap();
        for (direction, x, y) in [
            (Vec3::NEG_Z, 31.5, 15.5),
            (Vec3::X, 47.5, 15.5),
            (Vec3::NEG_X, 15.5, 15.5),
            (Vec3::new(0.0, 1.0, -1.0).normalize(), 31.5, 7.5),
        ] {
            let found = panorama.read(direction);
            assert!((found - Vec3::new(x, y, 0.0)).length() < 1e-3, "{direction}: {found}");
        }
        assert_eq!((panorama.read(Vec3::Y).y, panorama.read(Vec3::NEG_Y).y), (0.0, 31.0));
    }

    #[test]
    fn impossible_pictures_are_refused() {
        assert_eq!(Panorama::new(0, 4, Vec::new()), Err(PanoramaError::Size(0, 4)));
        assert_eq!(Panorama::new(1 << 16, 1 << 16, Vec::new()), Err(PanoramaError::Size(1 << 16, 1 << 16)));
        assert_eq!(Panorama::new(2, 2, vec![Vec3::ONE; 3]), Err(PanoramaError::Length(3, 2, 2)));
        let odd = Panorama::new(1, 1, vec![Vec3::new(f32::NAN, f32::INFINITY, -1.0)]).unwrap();
        assert_eq!(odd.read(Vec3::X), Vec3::new(0.0, packed::MOST, 0.0));
    }
}
