//! Filters, which are undone after the codec ATTRIBUTES. They work on vectors of four components, or on floats.

/// Makes unit vectors from the octahedron. The third component holds what stands for 1; the fourth stays.
pub(super) fn octahedral<const BYTES: usize>(data: &mut [u8]) {
    let most = if BYTES == 1 { 127.0 } else { 32767.0 };
    for vector in data.chunks_exact_mut(4 * BYTES) {
        let [x, y, one] = [0, 1, 2].map(|at| float(signed::<BYTES>(vector, at)));
        let z = one - x.abs() - y.abs();
        let fold = z.min(0.0);
        let x = x + if x >= 0.0 { fold } else { -fold };
        let y = y + if y >= 0.0 { fold } else { -fold };
        let scale = most / (x * x + y * y + z * z).sqrt();
        for (at, value) in [x, y, z].into_iter().enumerate() {
            write::<BYTES>(vector, at, rounded(value * scale));
        }
    }
}

/// Makes unit quaternions from three components. The fourth holds what stands for 1, and which component is left out.
pub(super) fn quaternion(data: &mut [u8]) {
    for vector in data.chunks_exact_mut(8) {
        let code = signed::<2>(vector, 3);
        let one = float(code | 3);
        let [x, y, z] = [0, 1, 2].map(|at| float(signed::<2>(vector, at)));
        let w = (one * one * 2.0 - x * x - y * y - z * z).max(0.0).sqrt();
        let scale = 32767.0 / std::f32::consts::SQRT_2 / one;
        let left_out = (code & 3).unsigned_abs() as usize;
        for (step, value) in [w, x, y, z].into_iter().enumerate() {
            write::<2>(vector, (left_out + step) & 3, rounded(value * scale));
        }
    }
}

/// Makes floats from a mantissa of 24 bits and an exponent of 8, both signed.
pub(super) fn exponential(data: &mut [u8]) {
    for word in data.chunks_exact_mut(4) {
        let value = i32::from_le_bytes(word.try_into().unwrap_or_default());
        let (mantissa, exponent) = (value << 8 >> 8, value >> 24);
        // As bits: exponents that no float has wrap, as they do in other decoders.
        let power = f32::from_bits((exponent + 127).cast_unsigned() << 23);
        word.copy_from_slice(&(power * float(mantissa)).to_le_bytes());
    }
}

/// Makes RGBA from luma and two differences (YCoCg). Alpha has one bit less; its highest bit tells what stands for 1.
pub(super) fn color<const BYTES: usize>(data: &mut [u8]) {
    let mask = (1 << (8 * BYTES)) - 1;
    for vector in data.chunks_exact_mut(4 * BYTES) {
        let [y, code] = [0, 3].map(|at| signed::<BYTES>(vector, at) & mask);
        let [orange, green] = [1, 2].map(|at| signed::<BYTES>(vector, at));
        let one = code.checked_ilog2().map_or(0, |bit| (2 << bit) - 1);
        let alpha = (code << 1 & one) | (code & 1);
        let scale = float(mask) / float(one);
        for (at, value) in [y + orange - green, y + green, y - orange - green, alpha].into_iter().enumerate() {
            write::<BYTES>(vector, at, truncated(float(value) * scale + 0.5));
        }
    }
}

fn signed<const BYTES: usize>(vector: &[u8], at: usize) -> i32 {
    match vector.get(at * BYTES..(at + 1) * BYTES) {
        Some(&[a]) => i8::from_le_bytes([a]).into(),
        Some(&[a, b]) => i16::from_le_bytes([a, b]).into(),
        _ => 0,
    }
}

/// Writes the low bytes of a value.
fn write<const BYTES: usize>(vector: &mut [u8], at: usize, value: i32) {
    for (to, from) in vector.iter_mut().skip(at * BYTES).take(BYTES).zip(value.to_le_bytes()) {
        *to = from;
    }
}

#[expect(clippy::cast_precision_loss, reason = "at most 24 bits")]
fn float(value: i32) -> f32 {
    value as f32
}

/// Rounds half away from zero, as other decoders do: by adding.
fn rounded(value: f32) -> i32 {
    truncated(value + if value >= 0.0 { 0.5 } else { -0.5 })
}

#[expect(clippy::cast_possible_truncation, reason = "it saturates, and NaN becomes 0: only broken data have such")]
fn truncated(value: f32) -> i32 {
    value as i32
}
