//! Transposition of 8×8 matrices of bits and bytes in registers.

/// Transposes an 8×8 matrix of bits: bit 8r + c goes to 8c + r. Swaps the off-diagonal quarters of every 2×2, then 4×4,
/// then the whole 8×8 block (Warren, Hacker's Delight, §7-3).
pub(super) const fn transpose_bits(mut bits: u64) -> u64 {
    let mut swap = (bits ^ bits >> 7) & 0x00AA_00AA_00AA_00AA;
    bits ^= swap ^ swap << 7;
    swap = (bits ^ bits >> 14) & 0x0000_CCCC_0000_CCCC;
    bits ^= swap ^ swap << 14;
    swap = (bits ^ bits >> 28) & 0x0000_0000_F0F0_F0F0;
    bits ^ swap ^ swap << 28
}

/// Transposes an 8×8 matrix of bytes, a row in each u64: swaps the off-diagonal quarters of the whole, then of each
/// quarter, and so on.
#[inline]
pub(super) const fn transpose_bytes(rows: [u64; 8]) -> [u64; 8] {
    const fn swap(a: u64, b: u64, shift: u32, low: u64) -> (u64, u64) {
        (a & low | (b & low) << shift, a >> shift & low | b & !low)
    }
    let [a, b, c, d, e, f, g, h] = rows;
    let low = 0x0000_0000_FFFF_FFFF;
    let ((a, e), (b, f), (c, g), (d, h)) =
        (swap(a, e, 32, low), swap(b, f, 32, low), swap(c, g, 32, low), swap(d, h, 32, low));
    let low = 0x0000_FFFF_0000_FFFF;
    let ((a, c), (b, d), (e, g), (f, h)) =
        (swap(a, c, 16, low), swap(b, d, 16, low), swap(e, g, 16, low), swap(f, h, 16, low));
    let low = 0x00FF_00FF_00FF_00FF;
    let ((a, b), (c, d), (e, f), (g, h)) =
        (swap(a, b, 8, low), swap(c, d, 8, low), swap(e, f, 8, low), swap(g, h, 8, low));
    [a, b, c, d, e, f, g, h]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn transposing_twice_changes_nothing() {
        let rows = [1, 0x0203, 0xFF00_0000_0000_0000, 4, 0x0123_4567_89AB_CDEF, 6, 7, u64::MAX];
        let transposed = transpose_bytes(rows);
        assert_eq!(transposed[7].to_le_bytes(), [0, 0, 0xFF, 0, 0x01, 0, 0, 0xFF]);
        assert_eq!(transpose_bytes(transposed), rows);
        assert_eq!(transpose_bits(1 << 9), 1 << 9);
        assert_eq!(transpose_bits(1 << 7), 1 << 56);
        for row in rows {
            assert_eq!(transpose_bits(transpose_bits(row)), row);
        }
    }
}
