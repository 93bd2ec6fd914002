//! Planes: one byte of one component of every element each, as differences from the previous element. LZ4 finds far
//! more repetition in them than in the floats.

use super::error::{PackError, broken};

/// Appends `elements` of `N` words as planes: one for each byte of each component.
pub(super) fn write_planes<T, const N: usize>(out: &mut Vec<u8>, elements: &[T], words: impl Fn(&T) -> [u32; N]) {
    for component in 0..N {
        for byte in 0..4 {
            let mut before = 0_u32;
            out.extend(elements.iter().map(|element| {
                let word = words(element)[component];
                let difference = word.wrapping_sub(std::mem::replace(&mut before, word));
                zigzag(difference).to_le_bytes()[byte]
            }));
        }
    }
}

/// Maps small differences of either sign to small numbers.
fn zigzag(difference: u32) -> u32 {
    (difference << 1) ^ (0_u32.wrapping_sub(difference >> 31))
}

fn unzigzag(word: u32) -> u32 {
    (word >> 1) ^ 0_u32.wrapping_sub(word & 1)
}

/// Bytes not read yet.
pub(super) struct Cursor<'a>(pub(super) &'a [u8]);

impl<'a> Cursor<'a> {
    pub(super) fn take(&mut self, count: usize) -> Result<&'a [u8], PackError> {
        let (taken, rest) = self
            .0
            .split_at_checked(count)
            .ok_or_else(|| broken(format!("{count} bytes expected, {} left", self.0.len())))?;
        self.0 = rest;
        Ok(taken)
    }

    /// Reads what [`write_planes`] wrote.
    pub(super) fn planes<T, const N: usize>(
        &mut self,
        count: u32,
        element: impl Fn([u32; N]) -> T,
    ) -> Result<Vec<T>, PackError> {
        let count = count as usize;
        let all = self.take(count * N * 4)?;
        let plane = |number: usize| all.get(number * count..(number + 1) * count).unwrap_or_default();
        let planes: [[&[u8]; 4]; N] =
            std::array::from_fn(|component| std::array::from_fn(|byte| plane(component * 4 + byte)));
        let mut words = [0_u32; N];
        let mut out = Vec::with_capacity(count);
        for index in 0..count {
            for (word, bytes) in words.iter_mut().zip(&planes) {
                let bytes = bytes.map(|plane| plane.get(index).copied().unwrap_or_default());
                *word = word.wrapping_add(unzigzag(u32::from_le_bytes(bytes)));
            }
            out.push(element(words));
        }
        Ok(out)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn planes_hold_any_words() {
        let elements: Vec<[u32; 3]> =
            vec![[0, u32::MAX, 1 << 31], [u32::MAX, 0, 1], [7, 7, 0x7fff_ffff], [7, 7, 0x8000_0001]];
        let mut bytes = Vec::new();
        write_planes(&mut bytes, &elements, |words| *words);
        let mut cursor = Cursor(&bytes);
        assert_eq!(cursor.planes(4, |words: [u32; 3]| words).unwrap(), elements);
        assert!(cursor.0.is_empty());
        assert!(Cursor(&bytes).planes(5, |words: [u32; 3]| words).is_err());
    }
}
