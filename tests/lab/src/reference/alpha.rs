//! Alpha of MASK surfaces in f64: bilinear filtering with an error bound.

use gnomon_scene::{AlphaMode, Material, Scene, Wrap};

#[derive(Debug, Clone)]
pub(super) struct AlphaTest {
    cutoff: f64,
    factor: f64,
    picture: Option<Picture>,
}

#[derive(Debug, Clone)]
struct Picture {
    width: i64,
    height: i64,
    wrap: [Wrap; 2],
    alpha: Vec<u8>,
}

impl AlphaTest {
    /// Returns `None` unless the material is MASK.
    pub(super) fn new(scene: &Scene, material: &Material) -> Option<Self> {
        let AlphaMode::Mask { cutoff } = material.alpha else { return None };
        let picture = material.base_color_texture.map(|texture| {
            let image = &scene.images[texture.image as usize];
            Picture {
                width: i64::from(image.width),
                height: i64::from(image.height),
                wrap: [texture.wrap_u, texture.wrap_v],
                alpha: image.rgba.chunks_exact(4).map(|texel| texel[3]).collect(),
            }
        });
        Some(Self { cutoff: f64::from(cutoff), factor: f64::from(material.base_color.w), picture })
    }

    /// The picture's longer side, in pixels; 0 without one.
    pub(super) fn side_px(&self) -> f64 {
        #[expect(clippy::cast_precision_loss, reason = "pictures are smaller than 2^53 pixels")]
        self.picture.as_ref().map_or(0.0, |picture| picture.width.max(picture.height) as f64)
    }

    /// Returns how far the alpha at (u, v) lies above the cutoff, and the error of that from f32 texture coordinates.
    /// The surface exists if the first is not negative.
    ///
    /// `vertices` is the alpha of the vertices there.
    pub(super) fn margin(&self, u: f64, v: f64, vertices: f64) -> (f64, f64) {
        let factor = self.factor * vertices;
        let Some(picture) = &self.picture else {
            // A constant is compared as it is; a mixture is rounded.
            return (factor - self.cutoff, if vertices < 1.0 { 1e-6 } else { 0.0 });
        };
        let (alpha, rounding) = picture.sample(u, v);
        (alpha * factor - self.cutoff, rounding * factor + 1e-6)
    }
}

impl Picture {
    /// Returns the alpha at (u, v), 0 to 1, and its error from f32 coordinates.
    fn sample(&self, u: f64, v: f64) -> (f64, f64) {
        #[expect(clippy::cast_precision_loss, reason = "pictures are smaller than 2^53 pixels")]
        let (x, y) = (u * self.width as f64 - 0.5, v * self.height as f64 - 0.5);
        #[expect(clippy::cast_possible_truncation, reason = "saturates; a coordinate that large has no texel to miss")]
        let (left, top) = (x.floor() as i64, y.floor() as i64);
        let (right_share, bottom_share) = (x - x.floor(), y - y.floor());
        let texel = |x: i64, y: i64| {
            let column = wrapped(x, self.width, self.wrap[0]);
            let row = wrapped(y, self.height, self.wrap[1]);
            let place = usize::try_from(row * self.width + column).unwrap_or(0);
            f64::from(self.alpha[place]) / 255.0
        };
        let (right, bottom) = (left.saturating_add(1), top.saturating_add(1));
        let corners = [texel(left, top), texel(right, top), texel(left, bottom), texel(right, bottom)];
        let upper = corners[0] + (corners[1] - corners[0]) * right_share;
        let lower = corners[2] + (corners[3] - corners[2]) * right_share;
        // u is rounded when it is interpolated, multiplied and shifted; the corners' spread bounds the slope.
        let spread = corners.iter().copied().fold(0.0, f64::max) - corners.iter().copied().fold(1.0, f64::min);
        let rounding_texels = (x.abs() + y.abs() + 2.0) * f64::from(f32::EPSILON) * 2.0;
        (upper + (lower - upper) * bottom_share, (spread * rounding_texels).min(1.0))
    }
}

/// Returns the texel for `index` in a row or column of `count`, by the wrap mode.
fn wrapped(index: i64, count: i64, wrap: Wrap) -> i64 {
    match wrap {
        Wrap::Repeat => index.rem_euclid(count),
        Wrap::ClampToEdge => index.clamp(0, count - 1),
        Wrap::MirroredRepeat => {
            let place = index.rem_euclid(2 * count);
            if place < count { place } else { 2 * count - 1 - place }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wrapping_repeats_mirrors_and_holds() {
        let row = |wrap| (-4..7).map(|i| wrapped(i, 3, wrap)).collect::<Vec<_>>();
        assert_eq!(row(Wrap::Repeat), [2, 0, 1, 2, 0, 1, 2, 0, 1, 2, 0]);
        assert_eq!(row(Wrap::MirroredRepeat), [2, 2, 1, 0, 0, 1, 2, 2, 1, 0, 0]);
        assert_eq!(row(Wrap::ClampToEdge), [0, 0, 0, 0, 0, 1, 2, 2, 2, 2, 2]);
    }

    #[test]
    fn samples_are_bilinear_between_texel_centres() {
        let picture = Picture { width: 2, height: 2, wrap: [Wrap::ClampToEdge; 2], alpha: vec![0, 255, 51, 102] };
        let close = |u, v, expected: f64| {
            let (alpha, rounding) = picture.sample(u, v);
            assert!((alpha - expected).abs() < 1e-12, "({u}, {v}) gives {alpha}");
            assert!(rounding < 1e-5);
        };
        for (u, v, expected) in [(0.25, 0.25, 0.0), (0.75, 0.25, 1.0), (0.25, 0.75, 0.2), (0.75, 0.75, 0.4)] {
            close(u, v, expected);
        }
        close(0.5, 0.25, 0.5);
        close(0.5, 0.5, 0.4);
        close(-3.0, 0.25, 0.0);
        close(9.0, 9.0, 0.4);
        let repeated = Picture { wrap: [Wrap::Repeat; 2], ..picture };
        assert!((repeated.sample(0.0, 0.25).0 - 0.5).abs() < 1e-12);
        assert!((repeated.sample(7.75, -2.75).0 - 1.0).abs() < 1e-12);
    }
}
