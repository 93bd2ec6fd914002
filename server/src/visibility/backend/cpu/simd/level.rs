//! The best implementation that this machine has.

#[cfg(target_arch = "x86_64")]
use super::avx2::Avx2;
use super::{lanes::WithSimd, portable::Portable};

/// The vector instructions of a machine.
#[derive(Debug, Clone, Copy)]
pub(in super::super) enum Level {
    /// AVX2 and FMA.
    #[cfg(target_arch = "x86_64")]
    Avx2(Avx2),
    Portable,
}

impl Level {
    pub(in super::super) fn detect() -> Self {
        #[cfg(target_arch = "x86_64")]
        if let Some(avx2) = Avx2::detect() {
            return Self::Avx2(avx2);
        }
        Self::Portable
    }

    pub(in super::super) fn name(self) -> &'static str {
        match self {
            #[cfg(target_arch = "x86_64")]
            Self::Avx2(_) => "AVX2",
            Self::Portable => "portable",
        }
    }

    /// Runs `work` compiled for this level.
    pub(in super::super) fn dispatch<W: WithSimd>(self, work: W) -> W::Output {
        match self {
            #[cfg(target_arch = "x86_64")]
            Self::Avx2(avx2) => avx2.dispatch(work),
            Self::Portable => work.run(Portable),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{
        super::lanes::{F8, Simd},
        *,
    };

    /// Runs every operation on awkward numbers. Returns exact results as bits, and fused ones separately.
    struct Everything;

    impl WithSimd for Everything {
        type Output = (Vec<[u32; 8]>, Vec<[f32; 8]>, Vec<u8>, [f32; 2]);
        #[inline(always)]
        fn run<S: Simd>(self, s: S) -> Self::Output {
            let a = s.load(&F8([1.5, -2.25, 0.0, -0.0, f32::INFINITY, 3e-39, f32::NAN, 1e30]));
            let b = s.load(&F8([-0.5, -2.25, -0.0, 7.0, 1.0, -1e-20, 2.0, f32::NAN]));
            let c = s.load(&F8([0.1, 0.2, 0.3, -0.4, -0.5, 0.6, 0.7, 1e-3]));
            let out = |f: S::F| {
                let mut to = F8::default();
                s.store(f, &mut to);
                to.0
            };
            let exact = [
                a + c,
                a - c,
                c * c,
                s.div(c, b),
                s.sqrt(s.abs(c)),
                s.min(a, b),
                s.max(a, b),
                s.abs(b),
                s.xor_sign(c, b),
                s.select(s.mask(0b1011_0001), a, c),
                s.select_negative(b, a, c),
                s.splat(2.5),
            ];
            let exact = exact.map(|f| out(f).map(|x| if x.is_nan() { u32::MAX } else { x.to_bits() })).to_vec();
            let fused = [s.fma(c, c, c), s.fms(c, c, c), s.fnma(c, c, c)].map(out).to_vec();
            let masks =
                [s.ge(a, b), s.gt(a, b), s.and(s.ge(c, b), s.gt(a, c)), s.mask(0xa5)].map(|m| s.bits(m)).to_vec();
            (exact, fused, masks, [s.lowest(c), s.highest(c)])
        }
    }

    #[test]
    fn the_levels_agree() {
        let plain = Level::Portable.dispatch(Everything);
        let best = Level::detect().dispatch(Everything);
        assert_eq!(plain.0, best.0);
        assert_eq!(plain.2, best.2);
        assert_eq!(plain.3, [-0.5, 0.7]);
        assert_eq!(plain.3, best.3);
        for (a, b) in plain.1.iter().flatten().zip(best.1.iter().flatten()) {
            assert!((a - b).abs() <= 1e-7, "{a} and {b}");
        }
        // Comparing a level with itself would prove nothing.
        #[cfg(target_arch = "x86_64")]
        assert_eq!(
            Level::detect().name() == "AVX2",
            is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma")
        );
    }
}
