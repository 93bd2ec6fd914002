//! Planes: one byte of one component of every element each, as differences from the previous element. Zstandard finds
//! far more repetition in them than in the floats.
//!
//! Where a texture or a crease splits vertices, their elements come back: those are written once.

use std::collections::{HashMap, hash_map::Entry};

use super::error::{PackError, broken};

/// Appends elements of `N` words: the number of distinct ones; for each element 0 if it is new, else how many distinct
/// ones ago its like came up; and the distinct ones as planes.
pub(super) fn write_distinct<T, const N: usize>(out: &mut Vec<u8>, elements: &[T], words: impl Fn(&T) -> [u32; N]) {
    let mut places = HashMap::new();
    let mut distinct = Vec::new();
    let mut backwards = Vec::with_capacity(elements.len());
    // Counts are below 2²⁴.
    let mut count = 0_u32;
    for element in elements {
        let element = words(element);
        backwards.push(match places.entry(element) {
            Entry::Occupied(place) => count - *place.get(),
            Entry::Vacant(place) => {
                place.insert(count);
                count += 1;
                distinct.push(element);
                0
            }
        });
    }
    out.extend(count.to_le_bytes());
    for byte in 0..4 {
        out.extend(backwards.iter().map(|word| word.to_le_bytes()[byte]));
    }
    write_planes(out, &distinct, |element| *element);
}

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

    /// Reads what [`write_distinct`] wrote.
    pub(super) fn distinct<T, const N: usize>(
        &mut self,
        count: u32,
        element: impl Fn([u32; N]) -> T,
    ) -> Result<Vec<T>, PackError> {
        let count = count as usize;
        let distinct = self.take(4)?.try_into().map_or(0, u32::from_le_bytes);
        let planes = self.take(count * 4)?;
        let plane = |byte: usize| planes.get(byte * count..(byte + 1) * count).unwrap_or_default();
        let planes: [&[u8]; 4] = std::array::from_fn(plane);
        if distinct as usize > count {
            return Err(broken(format!("{distinct} distinct elements of {count}")));
        }
        let distinct: Vec<[u32; N]> = self.planes(distinct, |words| words)?;
        let mut known = 0_usize;
        let mut out = Vec::with_capacity(count);
        for index in 0..count {
            let backwards = u32::from_le_bytes(planes.map(|plane| plane.get(index).copied().unwrap_or_default()));
            let place = known.checked_sub(backwards as usize);
            let words = place.and_then(|place| distinct.get(place));
            out.push(element(*words.ok_or_else(|| broken(format!("element {index} repeats none before it")))?));
            known += usize::from(backwards == 0);
        }
        if known == distinct.len() { Ok(out) } else { Err(broken(format!("{known} distinct elements, not all"))) }
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

    #[test]
    fn repeated_elements_are_written_once() {
        let elements: Vec<[u32; 2]> = vec![[1, 2], [3, 4], [1, 2], [1, 2], [5, 6], [3, 4]];
        let mut bytes = Vec::new();
        write_distinct(&mut bytes, &elements, |words| *words);
        assert_eq!(bytes.len(), 4 + 6 * 4 + 3 * 2 * 4);
        assert_eq!(bytes[4..10], [0, 0, 2, 2, 0, 2]);
        let read = |bytes: &[u8], count| Cursor(bytes).distinct(count, |words: [u32; 2]| words);
        assert_eq!(read(&bytes, 6).unwrap(), elements);
        assert_eq!(read(&0_u32.to_le_bytes(), 0).unwrap(), Vec::<[u32; 2]>::new());
        // One that repeats what is not there yet, too many distinct ones, and one too few.
        for (place, value) in [(4, 1), (6, 3), (0, 7), (0, 2), (6, 0)] {
            let mut other = bytes.clone();
            other[place] = value;
            assert!(read(&other, 6).is_err(), "{place} is {value}");
        }
    }
}
