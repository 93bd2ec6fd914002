//! The scene's pictures, all computed: a canvas, noise that repeats, and the encoders.

use std::io::Cursor;

use glam::{DVec2, DVec3, DVec4};
use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder, ImageError};

use super::rng::lattice;

pub(crate) mod cloth;
pub(crate) mod leaves;
pub(crate) mod metal;
pub(crate) mod stone;

const JPEG_QUALITY: u8 = 86;

/// A square picture: sRGB colour and linear alpha, 0 to 1, for each of size × size pixels.
pub(crate) struct Picture {
    size: u32,
    pixels: Vec<DVec4>,
}

impl Picture {
    /// `color` gets each pixel's centre, in 0 to 1 from the upper left.
    pub(crate) fn new(size: u32, color: impl Fn(DVec2) -> DVec4) -> Self {
        let at = |i: u32| (f64::from(i) + 0.5) / f64::from(size);
        let pixels = (0..size * size).map(|i| color(DVec2::new(at(i % size), at(i / size)))).collect();
        Self { size, pixels }
    }

    /// Returns the normal map of a relief that is high where this picture is bright: white stands `depth` of the
    /// picture's width above black. It repeats as the picture does.
    pub(crate) fn relief(&self, depth: f64) -> Self {
        let size = self.size as usize;
        let height = |x: usize, y: usize| {
            let color = self.pixels[(y % size) * size + x % size];
            depth * (0.3 * color.x + 0.6 * color.y + 0.1 * color.z)
        };
        // Neighbours on either side are two pixels apart.
        let per_width = f64::from(self.size) / 2.0;
        let pixels = (0..size * size).map(|i| {
            let (x, y) = (i % size, i / size);
            let right = (height(x + 1, y) - height(x + size - 1, y)) * per_width;
            let down = (height(x, y + 1) - height(x, y + size - 1)) * per_width;
            // Green points up in the picture (glTF 2.0, §3.9.3).
            let normal = DVec3::new(-right, down, 1.0).normalize();
            solid(normal * 0.5 + 0.5)
        });
        Self { size: self.size, pixels: pixels.collect() }
    }

    /// Returns a JPEG file; alpha is lost.
    pub(crate) fn jpeg(&self) -> Result<Vec<u8>, ImageError> {
        let bytes: Vec<u8> = self.pixels.iter().flat_map(|p| [byte(p.x), byte(p.y), byte(p.z)]).collect();
        let mut file = Vec::new();
        JpegEncoder::new_with_quality(Cursor::new(&mut file), JPEG_QUALITY).write_image(
            &bytes,
            self.size,
            self.size,
            ExtendedColorType::Rgb8,
        )?;
        Ok(file)
    }

    pub(crate) fn png(&self) -> Result<Vec<u8>, ImageError> {
        let bytes: Vec<u8> = self.pixels.iter().flat_map(|p| p.to_array().map(byte)).collect();
        let mut file = Vec::new();
        PngEncoder::new_with_quality(&mut file, CompressionType::Best, FilterType::Adaptive).write_image(
            &bytes,
            self.size,
            self.size,
            ExtendedColorType::Rgba8,
        )?;
        Ok(file)
    }
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "rounded and clamped to 0 ..= 255")]
fn byte(value: f64) -> u8 {
    (value * 255.0).round().clamp(0.0, 255.0) as u8
}

#[expect(clippy::cast_possible_truncation, reason = "pictures have far fewer than 2^63 cells")]
pub(crate) fn whole(value: f64) -> i64 {
    value.floor() as i64
}

/// Value noise in 0 to 1 that repeats after `period` cells.
pub(crate) fn noise(p: DVec2, period: i64, seed: u64) -> f64 {
    let (x, y) = (whole(p.x), whole(p.y));
    let f = p - p.floor();
    let f = f * f * (DVec2::splat(3.0) - 2.0 * f);
    let at = |i: i64, j: i64| lattice((x + i).rem_euclid(period), (y + j).rem_euclid(period), seed);
    let low = at(0, 0) + (at(1, 0) - at(0, 0)) * f.x;
    let high = at(0, 1) + (at(1, 1) - at(0, 1)) * f.x;
    low + (high - low) * f.y
}

/// `octaves` layers of noise over the unit square, the coarsest with `cells` cells a side; about −1 to 1.
pub(crate) fn clouds(uv: DVec2, cells: i64, octaves: u32, seed: u64) -> f64 {
    (0..octaves).fold(0.0, |sum, octave| {
        let period = cells << octave;
        let layer = noise(uv * period as f64, period, seed.wrapping_add(u64::from(octave) * 101));
        sum + (layer * 2.0 - 1.0) * 0.5f64.powf(f64::from(octave)) * 0.62
    })
}

pub(crate) fn solid(color: DVec3) -> DVec4 {
    color.clamp(DVec3::ZERO, DVec3::ONE).extend(1.0)
}

/// 0 below `low`, 1 above `high`, smooth in between.
pub(crate) fn step(low: f64, high: f64, value: f64) -> f64 {
    let t = ((value - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// Moves coordinates in 0 to 1 into one cell of an atlas of `side` × `side` cells, away from its edges.
pub(crate) fn atlas_cell(cell: usize, side: usize, uv: DVec2) -> DVec2 {
    let margin = 0.04;
    let inside = uv.clamp(DVec2::ZERO, DVec2::ONE) * (1.0 - 2.0 * margin) + margin;
    (DVec2::new((cell % side) as f64, (cell / side) as f64) + inside) / side as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_repeats_without_a_seam() {
        for y in [0.1, 3.7, 7.9] {
            let (left, right) = (noise(DVec2::new(0.0, y), 8, 3), noise(DVec2::new(8.0 - 1e-9, y), 8, 3));
            assert!((left - right).abs() < 1e-6);
        }
    }

    #[test]
    fn a_relief_leans_away_from_what_is_higher() {
        // A ridge from top to bottom, brightest in the middle.
        let ridge = Picture::new(16, |uv| solid(DVec3::splat(1.0 - (uv.x - 0.5).abs() * 2.0))).relief(0.25);
        let normal = |x: usize| ridge.pixels[8 * 16 + x].truncate() * 2.0 - 1.0;
        // Height rises by a quarter of the width over half of it.
        let expected = DVec3::new(-0.5, 0.0, 1.0).normalize();
        assert!(
            (normal(4) - expected).length() < 1e-9
                && (normal(11) * DVec3::new(-1.0, 1.0, 1.0) - expected).length() < 1e-9
        );
        // The same ridge from left to right leans up above its crest.
        let ridge = Picture::new(16, |uv| solid(DVec3::splat(1.0 - (uv.y - 0.5).abs() * 2.0))).relief(0.25);
        assert!(ridge.pixels[4 * 16 + 8].y > 0.7);
    }

    #[test]
    fn pictures_survive_their_encoders() {
        let picture = Picture::new(16, |uv| DVec4::new(uv.x, uv.y, 0.5, if uv.x > 0.5 { 1.0 } else { 0.0 }));
        let decoded = image::load_from_memory(&picture.png().unwrap()).unwrap().to_rgba8();
        assert_eq!((decoded.get_pixel(15, 0)[3], decoded.get_pixel(0, 0)[3]), (255, 0));
        assert_eq!(image::load_from_memory(&picture.jpeg().unwrap()).unwrap().width(), 16);
    }
}
