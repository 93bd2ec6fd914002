//! A small seeded random generator, so that the scene comes out the same byte for byte on every run.

/// SplitMix64 (Steele, Lea & Flood 2014, "Fast splittable pseudorandom number generators", figure 17).
#[derive(Debug, Clone)]
pub(crate) struct Rng(u64);

impl Rng {
    pub(crate) fn new(seed: u64) -> Self {
        Self(seed)
    }

    pub(crate) fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        mix(self.0)
    }

    /// Uniform in [0, 1).
    pub(crate) fn unit(&mut self) -> f64 {
        to_unit(self.bits())
    }

    /// Uniform in [low, high).
    pub(crate) fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    pub(crate) fn below(&mut self, count: usize) -> usize {
        usize::try_from(self.bits() % (count.max(1) as u64)).unwrap_or(0)
    }
}

/// A fixed value in [0, 1) for a lattice point, for noise.
pub(crate) fn lattice(x: i64, y: i64, seed: u64) -> f64 {
    let key = x.cast_unsigned().wrapping_mul(0x9E37_79B9_7F4A_7C15)
        ^ y.cast_unsigned().wrapping_mul(0xC2B2_AE3D_27D4_EB4F).rotate_left(31)
        ^ seed.wrapping_mul(0x1656_67B1_9E37_79F9);
    to_unit(mix(mix(key)))
}

fn mix(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

fn to_unit(bits: u64) -> f64 {
    // 53 bits, the mantissa of f64: exact, so the result is below 1.
    (bits >> 11) as f64 / (1u64 << 53) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sequence_is_the_published_one() {
        // First output of SplitMix64 with seed 0.
        assert_eq!(Rng::new(0).bits(), 0xE220_A839_7B1D_CDAF);
    }

    #[test]
    fn values_stay_in_range_and_spread() {
        let mut rng = Rng::new(7);
        let values: Vec<f64> = (0..1000).map(|_| rng.between(-2.0, 6.0)).collect();
        assert!(values.iter().all(|v| (-2.0..6.0).contains(v)));
        let mean = values.iter().sum::<f64>() / 1000.0;
        assert!((mean - 2.0).abs() < 0.3, "mean {mean}");
        assert!((0..100).map(|_| rng.below(3)).all(|v| v < 3));
    }
}
