//! Eight f32 lanes: AVX2 with FMA where the machine has them, plain arrays everywhere else.
//!
//! Code is generic over [`Simd`] and runs through [`Level::dispatch`], which compiles it once per level. Values of
//! `Avx2` exist only after a check for its instructions, which makes its calls sound. Only `avx2` is unsafe.
//!
//! The levels may differ in the last bit: AVX2 rounds a fused multiply-add once, plain arrays twice. On one machine
//! results are always the same.

#[cfg(target_arch = "x86_64")]
#[allow(unsafe_code, reason = "std::arch intrinsics; sound because `Avx2` exists only where the processor has them")]
mod avx2;
mod lanes;
mod level;
mod portable;

pub(super) use self::{
    lanes::{F8, Simd, WithSimd},
    level::Level,
};
