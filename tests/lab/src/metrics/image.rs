//! Error of a picture: PSNR, SSIM and FLIP.

use image::RgbImage;

use super::ssim::{self, ssim};

/// Smallest width and height that can be compared, in pixels: SSIM's window.
pub const MIN_SIDE_PX: u32 = ssim::WINDOW_PX;

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImageError {
    /// Peak signal-to-noise ratio over all pixels and channels, in decibels; infinite for equal pictures.
    pub psnr_db: f64,
    /// Mean structural similarity of the luma (Wang et al. 2004): 1 for equal pictures, less for others.
    pub ssim: f64,
    /// Mean FLIP error (Andersson et al. 2020), 67 pixels a degree: 0 for equal pictures, at most 1.
    pub flip: f64,
}

/// Compares two 8-bit sRGB pictures. Panics if their sizes differ or a side is below [`MIN_SIDE_PX`].
pub fn compare(shown: &RgbImage, truth: &RgbImage) -> ImageError {
    assert_eq!(shown.dimensions(), truth.dimensions(), "pictures of one size can be compared");
    ImageError { psnr_db: psnr_db(shown, truth), ssim: ssim(shown, truth), flip: flip(shown, truth) }
}

fn psnr_db(shown: &RgbImage, truth: &RgbImage) -> f64 {
    let square = |(&a, &b): (&u8, &u8)| u64::from(a.abs_diff(b)).pow(2);
    let squares: u64 = shown.as_raw().iter().zip(truth.as_raw()).map(square).sum();
    #[expect(clippy::cast_precision_loss, reason = "sums of squares of bytes of a picture stay below 2^53")]
    let mean = squares as f64 / truth.as_raw().len() as f64;
    if mean == 0.0 { f64::INFINITY } else { 10.0 * (255.0_f64.powi(2) / mean).log10() }
}

fn flip(shown: &RgbImage, truth: &RgbImage) -> f64 {
    let image = |image: &RgbImage| nv_flip::FlipImageRgb8::with_data(image.width(), image.height(), image.as_raw());
    let errors = nv_flip::flip(image(truth), image(shown), nv_flip::DEFAULT_PIXELS_PER_DEGREE).to_vec();
    // The crate's pool is a histogram; the mean does not need one.
    errors.iter().map(|&error| f64::from(error)).sum::<f64>() / errors.len() as f64
}

#[cfg(test)]
mod tests {
    use image::Rgb;

    use super::*;

    fn waves(width: u32, height: u32) -> RgbImage {
        RgbImage::from_fn(width, height, |x, y| {
            let wave = |period: f64, phase: f64| {
                let value = 128.0 + 90.0 * ((f64::from(x) / period + phase).sin() * (f64::from(y) / period).cos());
                #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "38 to 218")]
                let byte = value.round() as u8;
                byte
            };
            Rgb([wave(3.0, 0.0), wave(7.0, 1.0), wave(11.0, 2.0)])
        })
    }

    #[test]
    fn equal_pictures_have_no_error() {
        let picture = waves(40, 30);
        assert_eq!(compare(&picture, &picture), ImageError { psnr_db: f64::INFINITY, ssim: 1.0, flip: 0.0 });
    }

    #[test]
    fn noise_of_known_power_has_the_known_psnr() {
        let truth = waves(64, 48);
        // ±5 at every value: the mean square is 25.
        let mut odd = false;
        let mut noisy = truth.clone();
        for value in noisy.iter_mut() {
            odd = !odd;
            *value = if odd { *value + 5 } else { *value - 5 };
        }
        let error = compare(&noisy, &truth);
        assert!((error.psnr_db - 20.0 * (255.0_f64 / 5.0).log10()).abs() < 1e-9, "{error:?}");
        assert!(error.ssim < 1.0);
        // NVIDIA's own flip-evaluator 1.7 says 0.01674 of these two, and 0.96737 of black on white.
        assert!((error.flip - 0.016_74).abs() < 1e-4, "{error:?}");
        // One wrong channel of one pixel, fully: 255² over 64 × 48 × 3 values.
        let (mut black, mut spot) = (RgbImage::new(64, 48), RgbImage::new(64, 48));
        spot.put_pixel(20, 20, Rgb([0, 255, 0]));
        assert!((psnr_db(&spot, &black) - 10.0 * (64.0 * 48.0 * 3.0_f64).log10()).abs() < 1e-9);
        black.fill(255);
        assert!((flip(&black, &RgbImage::new(64, 48)) - 0.967_37).abs() < 1e-4);
    }

    #[test]
    fn more_error_is_worse_by_every_measure() {
        let truth = waves(64, 48);
        let shifted = |by: u8| {
            let mut picture = truth.clone();
            for (x, _, pixel) in picture.enumerate_pixels_mut() {
                if x % 16 < 8 {
                    pixel.0 = pixel.0.map(|value| value.saturating_sub(by));
                }
            }
            compare(&picture, &truth)
        };
        let (little, much) = (shifted(5), shifted(60));
        assert!(little.psnr_db > much.psnr_db && little.ssim > much.ssim && little.flip < much.flip);
    }
}
