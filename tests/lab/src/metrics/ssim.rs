//! Structural similarity as Wang, Bovik, Sheikh and Simoncelli define it ("Image quality assessment: from error
//! visibility to structural similarity", 2004): windows of 11×11 pixels under a Gaussian, on luma.
//!
//! The crate `image-compare` differs: it has 8×8 blocks, and sums instead of variances, so that its constant c₂ weighs
//! 64 times less and faint noise on a plain surface counts as a total loss of structure.

use image::RgbImage;
use rayon::prelude::*;

pub(super) const WINDOW_PX: u32 = 11;

const WINDOW: usize = WINDOW_PX as usize;
const SIGMA_PX: f64 = 1.5;
const C1: f64 = (0.01 * 255.0) * (0.01 * 255.0);
const C2: f64 = (0.03 * 255.0) * (0.03 * 255.0);

/// Sums of a window: both pictures, their squares, their product.
type Moments = [f64; 5];

/// Returns the mean over all windows inside the pictures, which must have one size.
pub(super) fn ssim(shown: &RgbImage, truth: &RgbImage) -> f64 {
    let (width, height) = (truth.width() as usize, truth.height() as usize);
    assert!(width >= WINDOW && height >= WINDOW, "{width}×{height}: SSIM's window has {WINDOW}×{WINDOW} pixels");
    let weights = weights();
    let (shown, truth) = (luma(shown), luma(truth));
    let columns = width - WINDOW + 1;
    let rows: Vec<Moments> = (0..height)
        .into_par_iter()
        .flat_map_iter(|y| {
            let (shown, truth) = (&shown[y * width..][..width], &truth[y * width..][..width]);
            (0..columns).map(move |x| {
                let mut sums = Moments::default();
                for ((&a, &b), weight) in shown[x..].iter().zip(&truth[x..]).zip(weights) {
                    add(&mut sums, [a, b, a * a, b * b, a * b], weight);
                }
                sums
            })
        })
        .collect();
    let rows = &rows;
    let of_row = |y: usize| {
        (0..columns).map(move |x| {
            let mut sums = Moments::default();
            for (row, weight) in weights.into_iter().enumerate() {
                add(&mut sums, rows[(y + row) * columns + x], weight);
            }
            of_window(sums)
        })
    };
    let windows = height - WINDOW + 1;
    // Rows are added in order, so that the sum does not depend on thread timing.
    let sums: Vec<f64> = (0..windows).into_par_iter().map(|y| of_row(y).sum()).collect();
    sums.iter().sum::<f64>() / (windows * columns) as f64
}

fn add(sums: &mut Moments, values: Moments, weight: f64) {
    for (sum, value) in sums.iter_mut().zip(values) {
        *sum += weight * value;
    }
}

fn of_window([a, b, aa, bb, ab]: Moments) -> f64 {
    let (variance_a, variance_b, covariance) = (aa - a * a, bb - b * b, ab - a * b);
    (2.0 * a * b + C1) * (2.0 * covariance + C2) / ((a * a + b * b + C1) * (variance_a + variance_b + C2))
}

fn weights() -> [f64; WINDOW] {
    let middle = f64::from(WINDOW_PX / 2);
    let mut weights = [0.0; WINDOW];
    for (x, weight) in (0..WINDOW_PX).zip(&mut weights) {
        *weight = (-(f64::from(x) - middle).powi(2) / (2.0 * SIGMA_PX * SIGMA_PX)).exp();
    }
    let sum: f64 = weights.iter().sum();
    weights.map(|weight| weight / sum)
}

/// Luma of ITU-R BT.601, not rounded.
fn luma(picture: &RgbImage) -> Vec<f64> {
    picture.pixels().map(|p| 0.299 * f64::from(p[0]) + 0.587 * f64::from(p[1]) + 0.114 * f64::from(p[2])).collect()
}

#[cfg(test)]
mod tests {
    use image::Rgb;

    use super::*;

    fn flat(value: u8) -> RgbImage {
        RgbImage::from_pixel(24, 17, Rgb([value; 3]))
    }

    #[test]
    fn flat_pictures_differ_by_their_means_alone() {
        let expected = (2.0 * 100.0 * 120.0 + C1) / (100.0_f64.powi(2) + 120.0_f64.powi(2) + C1);
        assert!((ssim(&flat(100), &flat(120)) - expected).abs() < 1e-9);
        assert!((ssim(&flat(77), &flat(77)) - 1.0).abs() < 1e-12);
    }

    /// scikit-image gives this value: `structural_similarity(a, b, gaussian_weights=True, sigma=1.5,
    /// use_sample_covariance=False, data_range=255)` of these pictures' luma in float64.
    #[test]
    fn ssim_equals_the_reference_implementations() {
        let picture = |phase: u32| {
            RgbImage::from_fn(48, 40, |x, y| {
                let value = |seed: u32| u8::try_from((x * x * 3 + y * 7 * seed + (x + phase) * y) % 251).unwrap_or(0);
                Rgb([value(1), value(2), value(3)])
            })
        };
        let figure = ssim(&picture(0), &picture(1));
        assert!((figure - 0.502_372_782_574).abs() < 1e-9, "{figure}");
    }
}
