//! Reads and writes the bits of prefix codes, highest bit of a byte first.

/// Appends bits to a buffer.
#[derive(Debug)]
pub(super) struct BitWriter<'a> {
    /// Bits that are not in the output yet, the newest lowest.
    held: u64,
    count: u32,
    start: usize,
    output: &'a mut Vec<u8>,
}

/// A state of the writer to roll back to.
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

    pub(super) fn position(&self) -> Position {
        Position { held: self.held, count: self.count, end: self.output.len() }
    }

    /// Undoes everything written since `position`.
    pub(super) fn rollback(&mut self, Position { held, count, end }: Position) {
        (self.held, self.count) = (held, count);
        self.output.truncate(end);
    }

    /// Returns the bytes written so far, including one that is not full.
    pub(super) fn bytes(&self) -> usize {
        self.output.len() - self.start + self.count.div_ceil(8) as usize
    }

    /// Writes the `count` lowest bits of `bits`, at most 32. The others must be 0.
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

    /// Writes the Elias γ code of `number` + 1: small numbers take few bits.
    pub(super) fn put_number(&mut self, number: u16) {
        let number = u32::from(number) + 1;
        let more = number.ilog2();
        self.put(0, more);
        self.put(number, more + 1);
    }

    /// Pads the last byte with zeros.
    pub(super) fn finish(self) {
        let bytes = (self.held << ((64 - self.count) % 64)).to_be_bytes();
        self.output.extend_from_slice(&bytes[..self.count.div_ceil(8) as usize]);
    }
}

/// Reads bits, and zeros after the end.
#[derive(Debug)]
pub(super) struct BitReader<'a> {
    /// The next bits, the first one highest.
    window: u64,
    /// Bits in the window, zeros after the end included.
    count: u32,
    rest: &'a [u8],
    /// Bits of the slice that are not in the window; negative if the window has zeros from after the end.
    left: i64,
}

impl<'a> BitReader<'a> {
    pub(super) fn new(slice: &'a [u8]) -> Self {
        let left = i64::try_from(slice.len()).map_or(i64::MAX, |bytes| bytes * 8);
        let mut reader = Self { window: 0, count: 0, rest: slice, left };
        reader.fill();
        reader
    }

    /// Returns the bits left; negative after reading past the end.
    const fn left(&self) -> i64 {
        self.left + self.count as i64
    }

    /// False after reading past the end.
    #[inline(always)]
    pub(super) const fn is_within(&self) -> bool {
        self.left() >= 0
    }

    /// True if only zero bits of the last byte are left.
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

    /// Returns the next `bits` bits, 1 to 32, without consuming them.
    #[inline(always)]
    pub(super) const fn peek(&self, bits: u32) -> usize {
        #[expect(clippy::cast_possible_truncation, reason = "at most 32 bits")]
        let bits = (self.window >> (64 - bits)) as usize;
        bits
    }

    /// Consumes `count` bits, at most 32.
    #[inline(always)]
    pub(super) fn skip(&mut self, count: u32) {
        self.window <<= count;
        self.count -= count;
        if self.count < 32 {
            self.fill();
        }
    }

    /// Reads what [`BitWriter::put_number`] wrote. Returns `None` for any other bits.
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
    fn bits_and_numbers_round_trip() {
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
