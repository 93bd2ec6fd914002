//! Eight lanes in one AVX register, with fused multiply-add.

use std::arch::x86_64::{
    __m256, _CMP_GE_OQ, _CMP_GT_OQ, _MM_HINT_T0, _mm_cvtss_f32, _mm_max_ps, _mm_max_ss, _mm_min_ps, _mm_min_ss,
    _mm_movehl_ps, _mm_prefetch, _mm_shuffle_ps, _mm256_add_ps, _mm256_and_ps, _mm256_and_si256, _mm256_andnot_ps,
    _mm256_blendv_ps, _mm256_castps256_ps128, _mm256_castsi256_ps, _mm256_cmp_ps, _mm256_cmpeq_epi32, _mm256_div_ps,
    _mm256_extractf128_ps, _mm256_fmadd_ps, _mm256_fmsub_ps, _mm256_fnmadd_ps, _mm256_load_ps, _mm256_max_ps,
    _mm256_min_ps, _mm256_movemask_ps, _mm256_mul_ps, _mm256_set1_epi32, _mm256_set1_ps, _mm256_setr_epi32,
    _mm256_sqrt_ps, _mm256_store_ps, _mm256_sub_ps, _mm256_xor_ps,
};
use std::ops::{Add, Mul, Sub};

use super::lanes::{F8, Simd, WithSimd};

/// Proof that this machine has AVX2 and FMA.
#[derive(Debug, Clone, Copy)]
pub(in super::super) struct Avx2(());

/// Eight numbers in a register. Only [`Avx2`] makes them, so they are proof as well.
#[derive(Debug, Clone, Copy)]
pub(in super::super) struct Register(__m256);

impl Avx2 {
    /// `None` without AVX2 and FMA.
    pub(in super::super) fn detect() -> Option<Self> {
        (is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma")).then_some(Self(()))
    }

    /// Runs `work` compiled with AVX2 and FMA.
    pub(in super::super) fn dispatch<W: WithSimd>(self, work: W) -> W::Output {
        #[target_feature(enable = "avx2,fma")]
        fn with_features<W: WithSimd>(simd: Avx2, work: W) -> W::Output {
            work.run(simd)
        }
        // SAFETY: `self` proves that the processor has both features.
        unsafe { with_features(self, work) }
    }
}

macro_rules! operator {
    ($trait:ident, $method:ident, $intrinsic:ident) => {
        impl $trait for Register {
            type Output = Self;
            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                // SAFETY: a `Register` exists only where the processor has AVX2 and FMA.
                Self(unsafe { $intrinsic(self.0, other.0) })
            }
        }
    };
}
operator!(Add, add, _mm256_add_ps);
operator!(Sub, sub, _mm256_sub_ps);
operator!(Mul, mul, _mm256_mul_ps);

macro_rules! call {
    ($($body:tt)*) => {
        // SAFETY: `self` proves that the processor has AVX2 and FMA. Pointers come from references; what is loaded or
        // stored is an aligned F8.
        unsafe { $($body)* }
    };
}

impl Simd for Avx2 {
    type F = Register;
    type M = Register;
    #[inline(always)]
    fn splat(self, x: f32) -> Register {
        Register(call!(_mm256_set1_ps(x)))
    }
    #[inline(always)]
    fn load(self, x: &F8) -> Register {
        Register(call!(_mm256_load_ps(x.0.as_ptr())))
    }
    #[inline(always)]
    fn store(self, x: Register, to: &mut F8) {
        call!(_mm256_store_ps(to.0.as_mut_ptr(), x.0));
    }
    #[inline(always)]
    fn fma(self, a: Register, b: Register, c: Register) -> Register {
        Register(call!(_mm256_fmadd_ps(a.0, b.0, c.0)))
    }
    #[inline(always)]
    fn fms(self, a: Register, b: Register, c: Register) -> Register {
        Register(call!(_mm256_fmsub_ps(a.0, b.0, c.0)))
    }
    #[inline(always)]
    fn fnma(self, a: Register, b: Register, c: Register) -> Register {
        Register(call!(_mm256_fnmadd_ps(a.0, b.0, c.0)))
    }
    #[inline(always)]
    fn div(self, a: Register, b: Register) -> Register {
        Register(call!(_mm256_div_ps(a.0, b.0)))
    }
    #[inline(always)]
    fn sqrt(self, a: Register) -> Register {
        Register(call!(_mm256_sqrt_ps(a.0)))
    }
    #[inline(always)]
    fn min(self, a: Register, b: Register) -> Register {
        Register(call!(_mm256_min_ps(a.0, b.0)))
    }
    #[inline(always)]
    fn max(self, a: Register, b: Register) -> Register {
        Register(call!(_mm256_max_ps(a.0, b.0)))
    }
    #[inline(always)]
    fn abs(self, a: Register) -> Register {
        Register(call!(_mm256_andnot_ps(_mm256_set1_ps(-0.0), a.0)))
    }
    #[inline(always)]
    fn xor_sign(self, a: Register, sign: Register) -> Register {
        Register(call!(_mm256_xor_ps(a.0, _mm256_and_ps(sign.0, _mm256_set1_ps(-0.0)))))
    }
    #[inline(always)]
    fn ge(self, a: Register, b: Register) -> Register {
        Register(call!(_mm256_cmp_ps::<_CMP_GE_OQ>(a.0, b.0)))
    }
    #[inline(always)]
    fn gt(self, a: Register, b: Register) -> Register {
        Register(call!(_mm256_cmp_ps::<_CMP_GT_OQ>(a.0, b.0)))
    }
    #[inline(always)]
    fn and(self, a: Register, b: Register) -> Register {
        Register(call!(_mm256_and_ps(a.0, b.0)))
    }
    #[inline(always)]
    fn bits(self, m: Register) -> u8 {
        let bits = call!(_mm256_movemask_ps(m.0));
        // Eight lanes give eight bits.
        bits.to_le_bytes()[0]
    }
    #[inline(always)]
    fn mask(self, bits: u8) -> Register {
        Register(call!({
            let places = _mm256_setr_epi32(1, 2, 4, 8, 16, 32, 64, 128);
            let set = _mm256_and_si256(_mm256_set1_epi32(i32::from(bits)), places);
            _mm256_castsi256_ps(_mm256_cmpeq_epi32(set, places))
        }))
    }
    #[inline(always)]
    fn select(self, m: Register, a: Register, b: Register) -> Register {
        Register(call!(_mm256_blendv_ps(b.0, a.0, m.0)))
    }
    #[inline(always)]
    fn select_negative(self, sign: Register, a: Register, b: Register) -> Register {
        Register(call!(_mm256_blendv_ps(b.0, a.0, sign.0)))
    }
    #[inline(always)]
    fn lowest(self, a: Register) -> f32 {
        call!({
            let four = _mm_min_ps(_mm256_castps256_ps128(a.0), _mm256_extractf128_ps::<1>(a.0));
            let two = _mm_min_ps(four, _mm_movehl_ps(four, four));
            _mm_cvtss_f32(_mm_min_ss(two, _mm_shuffle_ps::<1>(two, two)))
        })
    }
    #[inline(always)]
    fn highest(self, a: Register) -> f32 {
        call!({
            let four = _mm_max_ps(_mm256_castps256_ps128(a.0), _mm256_extractf128_ps::<1>(a.0));
            let two = _mm_max_ps(four, _mm_movehl_ps(four, four));
            _mm_cvtss_f32(_mm_max_ss(two, _mm_shuffle_ps::<1>(two, two)))
        })
    }
    #[inline(always)]
    fn prefetch<T>(self, data: &T) {
        let first = std::ptr::from_ref(data).cast::<i8>();
        for at in (0..size_of::<T>()).step_by(64) {
            call!(_mm_prefetch::<_MM_HINT_T0>(first.add(at)));
        }
    }
}
