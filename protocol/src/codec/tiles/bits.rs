//! Whole bits in and out, the first in a byte's highest place: what prefix codes are written with.

/// Writes bits to the end of a buffer.
#[derive(Debug)]
pub(super) struct BitWriter<'a> {
    /// Bits that are not in the output yet, the last one lowest.
    held: u64,
    count: u32,
    start: usize,
    output: &'a mut Vec<u8>,
}

/// A place in the output to go back to.
#[derive(Debug, Clone, Copy)]
pub(super) struct Position {
    held: u64,
    count: u32,
    end: usize,
}

impl<'a> BitWriter<'a> {
    pub(super) fn new(output: &'a mut Vec<u8>) -> Self {
        Self { held: 0, count: 0, start: output.len(), output }
    }

    /// A place to come back to.
    pub(super) fn position(&self) -> Position {
        Position { held: self.held, count: self.count, end: self.output.len() }
    }

    /// Takes everything back that was written since.
    pub(super) fn rollback(&mut self, Position { held, count, end }: Position) {
        (self.held, self.count) = (held, count);
        self.output.truncate(end);
    }

    /// Bytes that have bits in them.
    pub(super) fn bytes(&self) -> usize {
        self.output.len() - self.start + self.count.div_ceil(8) as usize
    }

    /// Writes the `count` lowest bits of `bits`, whose others are 0; at most 32.
    #[inline(always)]
    pub(super) fn put(&mut self, bits: u32, count: u32) {
        self.held = self.held << count | u64::from(bits);
        self.count += count;
        if self.count >= 32 {
            self.count -= 32;
            let [.., a, b, c, d] = (self.held >> self.count).to_be_bytes();
            self.output.extend_from_slice(&[a, b, c, d]);
        }
    }

    /// Writes a number, small ones in few bits: Elias' γ code of the number after it.
    pub(super) fn put_number(&mut self, number: u16) {
        let number = u32::from(number) + 1;
        let more = number.ilog2();
        self.put(0, more);
        self.put(number, more + 1);
    }

    /// Fills the last byte with zeros.
    pub(super) fn finish(self) {
        let bytes = (self.held << ((64 - self.count) % 64)).to_be_bytes();
        self.output.extend_from_slice(&bytes[..self.count.div_ceil(8) as usize]);
    }
}

/// Reads bits. Behind the end it reads zeros.
#[derive(Debug)]
pub(super) struct BitReader<'a> {
    /// The next bits, the first one highest.
    window: u64,
    /// How many of them have been read from the slice, or from behind its end.
    count: u32,
    rest: &'a [u8],
    /// Bits of the slice that are not in the window; negative when it holds more than there were.
    left: i64,
}

impl<'a> BitReader<'a> {
    pub(super) fn new(slice: &'a [u8]) -> Self {
        let left = i64::try_from(slice.len()).map_or(i64::MAX, |bytes| bytes * 8);
        let mut reader = Self { window: 0, count: 0, rest: slice, left };
        reader.fill();
        reader
    }

    /// Bits that are left; negative when there were too few.
    const fn left(&self) -> i64 {
        self.left + self.count as i64
    }

    /// Whether there were as many bits as have been read.
    #[inline(always)]
    pub(super) const fn is_within(&self) -> bool {
        self.left() >= 0
    }

    /// Whether nothing is left over but zeros in the last byte.
    pub(super) const fn is_at_end(&self) -> bool {
        matches!(self.left(), 0..8) && self.window == 0
    }

    #[inline(always)]
    fn fill(&mut self) {
        let mut word = [0; 4];
        if let Some((first, rest)) = self.rest.split_first_chunk() {
            word = *first;
            self.rest = rest;
        } else {
            word[..self.rest.len()].copy_from_slice(self.rest);
            self.rest = &[];
        }
        self.window |= u64::from(u32::from_be_bytes(word)) << (32 - self.count);
        self.count += 32;
        self.left -= 32;
    }

    /// The next bits, which stay; 1 to 32.
    #[inline(always)]
    pub(super) const fn peek(&self, bits: u32) -> usize {
        #[expect(clippy::cast_possible_truncation, reason = "at most 32 bits")]
        let bits = (self.window >> (64 - bits)) as usize;
        bits
    }

    /// Leaves `count` bits behind, at most 32.
    #[inline(always)]
    pub(super) fn skip(&mut self, count: u32) {
        self.window <<= count;
        self.count -= count;
        if self.count < 32 {
            self.fill();
        }
    }

    /// Reads what [`BitWriter::put_number`] wrote; nothing where that is no such number.
    pub(super) fn number(&mut self) -> Option<u16> {
        let more = self.window.leading_zeros();
        if more > 16 {
            return None;
        }
        self.skip(more);
        let number = self.window >> (63 - more);
        self.skip(more + 1);
        u16::try_from(number - 1).ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_and_numbers_come_back() {
        let mut output = vec![7];
        let mut writer = BitWriter::new(&mut output);
        let pieces = (0..500_u32).map(|n| (n.wrapping_mul(2_654_435_761) & ((1 << (n % 20 + 1)) - 1), n % 20 + 1));
        let numbers = [0, 1, 2, 3, 254, 255, 256, 65_534, 65_535];
        for (bits, count) in pieces.clone() {
            writer.put(bits, count);
        }
        numbers.iter().for_each(|number| writer.put_number(*number));
        let bytes = writer.bytes();
        let position = writer.position();
        pieces.clone().for_each(|(bits, count)| writer.put(bits, count));
        writer.rollback(position);
        writer.finish();
        assert_eq!(output.len(), 1 + bytes);
        let mut reader = BitReader::new(&output[1..]);
        for (bits, count) in pieces {
            assert_eq!(reader.peek(20) >> (20 - count), bits as usize);
            reader.skip(count);
        }
        for number in numbers {
            assert_eq!(reader.number(), Some(number));
        }
        assert!(reader.is_at_end());
        reader.skip(8);
        assert!(!reader.is_within());
        assert!(!BitReader::new(&[0]).is_at_end());
        assert!(!BitReader::new(&[1]).is_at_end());
        assert_eq!(BitReader::new(&[0, 0, 0xFF, 0xFF]).number(), None);
        assert_eq!(BitReader::new(&[0; 4]).number(), None);
    }
}
