//! Radiance in 32 bits: three mantissas of 9 bits and one exponent (`VK_FORMAT_E5B9G9R9_UFLOAT_PACK32`).

use glam::Vec3;

/// Largest value that fits: 511 · 2⁷.
pub(super) const MOST: f32 = 65408.0;

pub(super) fn rgb9e5(radiance: Vec3) -> u32 {
    // NaN becomes 0.
    let clamped = radiance.max(Vec3::ZERO).min(Vec3::splat(MOST));
    let largest = clamped.max_element();
    if largest.is_nan() || largest <= 0.0 {
        return 0;
    }
    // Texel = mantissa · 2^(exponent − 24). One step higher if the largest mantissa would round to 512.
    let mut exponent = (largest.log2().floor().max(-16.0) + 16.0).clamp(0.0, 31.0);
    if (largest / (exponent - 24.0).exp2()).round() > 511.0 {
        exponent += 1.0;
    }
    let unit = (exponent - 24.0).exp2();
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 to 511, and 0 to 31")]
    let (mantissas, exponent) =
        ((clamped / unit).to_array().map(|value| (value.round() as u32).min(511)), exponent as u32);
    mantissas[0] | mantissas[1] << 9 | mantissas[2] << 18 | exponent.min(31) << 27
}

#[cfg(test)]
mod tests {
    use super::*;

    fn unpacked(bits: u32) -> Vec3 {
        #[expect(clippy::cast_precision_loss, reason = "9 bits")]
        let mantissa = |shift: u32| ((bits >> shift) & 511) as f32;
        let exponent = i32::try_from(bits >> 27).unwrap();
        Vec3::new(mantissa(0), mantissa(9), mantissa(18)) * 2.0_f32.powi(exponent - 24)
    }

    #[test]
    fn values_keep_nine_bits_of_the_largest_channel() {
        for radiance in [Vec3::ONE, Vec3::new(0.1, 0.02, 3.0), Vec3::splat(511.7), Vec3::new(6e4, 1.0, 0.0)] {
            let error = (unpacked(rgb9e5(radiance)) - radiance).abs().max_element();
            assert!(error <= radiance.max_element() / 512.0, "{radiance}: {error}");
        }
    }

    #[test]
    fn what_does_not_fit_is_clamped() {
        assert_eq!(unpacked(rgb9e5(Vec3::new(1e9, -3.0, f32::NAN))), Vec3::new(MOST, 0.0, 0.0));
        assert_eq!(rgb9e5(Vec3::ZERO), 0);
        assert_eq!(rgb9e5(Vec3::splat(1e-12)) & 0x7ff_ffff, 0);
    }
}
