//! A binary range coder (Martin 1979; the carry is held back as in Schindler's and LZMA's coders).
//!
//! The interval has 64 bits and is output in words of 32. A word is held until no carry can reach it, so output never
//! changes: an encoder can roll back to an earlier state and truncate its output there.

use super::{
    bit_model::{BitModel, SLOW},
    symbol_model::{PARTS_BITS, SYMBOLS, SymbolModel},
};

/// Bytes output at once.
const WORD_BYTES: usize = 4;

/// Most bytes that the end of a slice adds to the words output so far.
const TAIL_BYTES: usize = 8;

/// An encoder, a decoder or a counter: one model serves all.
pub(super) trait BinaryCoder {
    /// State that changes with every bit. A loop keeps it in registers, which it cannot do with the rest.
    type Registers: Copy;

    fn registers(&self) -> Self::Registers;

    fn set_registers(&mut self, registers: Self::Registers);

    /// Codes `bit` and returns it; a decoder ignores `bit` and returns the coded one. The model learns at `RATE`.
    fn bit_in<const RATE: u32>(&mut self, registers: &mut Self::Registers, model: &mut BitModel, bit: bool) -> bool;

    /// As [`Self::bit_in`], for a bit outside any loop.
    #[inline(always)]
    fn bit(&mut self, model: &mut BitModel, bit: bool) -> bool {
        let mut registers = self.registers();
        let bit = self.bit_in::<SLOW>(&mut registers, model, bit);
        self.set_registers(registers);
        bit
    }

    /// Codes one of eight symbols, as [`Self::bit_in`].
    fn symbol_in(&mut self, registers: &mut Self::Registers, model: &mut SymbolModel, symbol: usize) -> usize;
}

#[derive(Debug, Clone, Copy)]
pub(super) struct Interval {
    low: u64,
    range: u64,
}

/// Output that a carry may still change.
#[derive(Debug, Clone, Copy)]
struct Held {
    /// The newest word that left the interval, those in `ones` aside; `None` before the first.
    word: Option<u32>,
    /// Words of all ones after it, through which a carry would run.
    ones: usize,
    /// End of the final words in the output.
    end: usize,
}

/// A state of the encoder to roll back to.
#[derive(Debug, Clone, Copy)]
pub(super) struct Position {
    interval: Interval,
    held: Held,
}

/// Appends coded bits to a buffer.
#[derive(Debug)]
pub(super) struct RangeEncoder<'a> {
    interval: Interval,
    held: Held,
    start: usize,
    output: &'a mut Vec<u8>,
}

impl<'a> RangeEncoder<'a> {
    pub(super) fn new(output: &'a mut Vec<u8>) -> Self {
        let start = output.len();
        let held = Held { word: None, ones: 0, end: start };
        Self { interval: Interval { low: 0, range: u64::MAX }, held, start, output }
    }

    pub(super) const fn position(&self) -> Position {
        Position { interval: self.interval, held: self.held }
    }

    /// Undoes everything coded since `position`.
    pub(super) fn rollback(&mut self, Position { interval, held }: Position) {
        (self.interval, self.held) = (interval, held);
        self.output.truncate(held.end);
    }

    /// Returns the most bytes that the slice takes if it ends here.
    pub(super) fn most_bytes(&self) -> usize {
        let Held { word, ones, end } = self.held;
        end - self.start + (usize::from(word.is_some()) + ones) * WORD_BYTES + TAIL_BYTES
    }

    /// Raises the interval's lower end.
    #[inline(always)]
    fn raise(&mut self, registers: &mut Interval, by: u64) {
        let (low, carry) = registers.low.overflowing_add(by);
        registers.low = low;
        if carry {
            self.carry();
        }
    }

    /// Widens an interval that has become narrow. Once is enough, since no bit or symbol takes more than 12 bits.
    #[inline(always)]
    fn widen(&mut self, registers: &mut Interval) {
        if high_word(registers.range) == 0 {
            self.take(high_word(registers.low));
            registers.low <<= 32;
            registers.range <<= 32;
        }
    }

    fn put(&mut self, word: u32) {
        self.output.extend_from_slice(&word.to_be_bytes());
        self.held.end += WORD_BYTES;
    }

    /// A word does not overflow, because only one carry can ever reach it.
    #[cold]
    #[inline(never)]
    fn carry(&mut self) {
        let Some(word) = self.held.word else { return };
        let mut word = word.wrapping_add(1);
        for _ in 0..std::mem::take(&mut self.held.ones) {
            self.put(word);
            word = 0;
        }
        self.held.word = Some(word);
    }

    fn release(&mut self) {
        if let Some(word) = self.held.word.take() {
            self.put(word);
        }
        for _ in 0..std::mem::take(&mut self.held.ones) {
            self.put(u32::MAX);
        }
    }

    /// Holds a word that left the interval.
    #[cold]
    #[inline(never)]
    fn take(&mut self, word: u32) {
        if word == u32::MAX && self.held.word.is_some() {
            self.held.ones += 1;
        } else {
            self.release();
            self.held.word = Some(word);
        }
    }

    /// Ends the slice with the fewest bytes that identify a number in the interval.
    pub(super) fn finish(mut self) {
        let Interval { low, range } = self.interval;
        for kept in 0..=TAIL_BYTES {
            let cut = if kept == TAIL_BYTES { 0 } else { u64::MAX >> (8 * kept) };
            let (sum, carry) = low.overflowing_add(cut);
            let number = sum & !cut;
            if number.wrapping_sub(low) < range {
                if carry {
                    self.carry();
                }
                self.release();
                self.output.extend_from_slice(&number.to_be_bytes()[..kept]);
                return;
            }
        }
    }
}

impl BinaryCoder for RangeEncoder<'_> {
    type Registers = Interval;

    fn registers(&self) -> Interval {
        self.interval
    }

    fn set_registers(&mut self, registers: Interval) {
        self.interval = registers;
    }

    #[inline(always)]
    fn bit_in<const RATE: u32>(&mut self, registers: &mut Interval, model: &mut BitModel, bit: bool) -> bool {
        let bound = (registers.range >> 16) * u64::from(model.one());
        if bit {
            registers.range = bound;
        } else {
            self.raise(registers, bound);
            registers.range -= bound;
        }
        model.learn::<RATE>(bit);
        self.widen(registers);
        bit
    }

    #[inline(always)]
    fn symbol_in(&mut self, registers: &mut Interval, model: &mut SymbolModel, symbol: usize) -> usize {
        let part = registers.range >> PARTS_BITS;
        let [from, to] = model.share(symbol);
        self.raise(registers, part * u64::from(from));
        registers.range = part * u64::from(to - from);
        model.learn(symbol);
        self.widen(registers);
        symbol
    }
}

/// The decoder's interval, which begins at 0.
#[derive(Debug, Clone, Copy)]
pub(super) struct Window {
    code: u64,
    range: u64,
}

/// Decodes what [`RangeEncoder`] made. Reads zeros after the end of the slice.
#[derive(Debug)]
pub(super) struct RangeDecoder<'a> {
    window: Window,
    rest: &'a [u8],
    bytes: usize,
    /// Bytes that have left the interval.
    used: usize,
}

impl<'a> RangeDecoder<'a> {
    pub(super) fn new(slice: &'a [u8]) -> Self {
        let mut decoder =
            Self { window: Window { code: 0, range: u64::MAX }, rest: slice, bytes: slice.len(), used: 0 };
        decoder.window.code = u64::from(decoder.read()) << 32 | u64::from(decoder.read());
        decoder
    }

    /// False once the slice is too short: an encoder writes every word that leaves the interval.
    pub(super) const fn is_within(&self) -> bool {
        self.used <= self.bytes
    }

    /// True if no bytes are left over.
    pub(super) const fn is_at_end(&self) -> bool {
        self.is_within() && self.bytes <= self.used + TAIL_BYTES
    }

    fn read(&mut self) -> u32 {
        let mut word = [0; WORD_BYTES];
        if let Some((first, rest)) = self.rest.split_first_chunk() {
            word = *first;
            self.rest = rest;
        } else {
            word[..self.rest.len()].copy_from_slice(self.rest);
            self.rest = &[];
        }
        u32::from_be_bytes(word)
    }

    #[inline(always)]
    fn widen(&mut self, registers: &mut Window) {
        if high_word(registers.range) == 0 {
            registers.range <<= 32;
            registers.code = registers.code << 32 | u64::from(self.next());
        }
    }

    /// Reads the next word, after one has left the interval.
    #[cold]
    #[inline(never)]
    fn next(&mut self) -> u32 {
        self.used += WORD_BYTES;
        self.read()
    }
}

impl BinaryCoder for RangeDecoder<'_> {
    type Registers = Window;

    fn registers(&self) -> Window {
        self.window
    }

    fn set_registers(&mut self, registers: Window) {
        self.window = registers;
    }

    #[inline(always)]
    fn bit_in<const RATE: u32>(&mut self, registers: &mut Window, model: &mut BitModel, _: bool) -> bool {
        let bound = (registers.range >> 16) * u64::from(model.one());
        let bit = registers.code < bound;
        if bit {
            registers.range = bound;
        } else {
            registers.code -= bound;
            registers.range -= bound;
        }
        model.learn::<RATE>(bit);
        self.widen(registers);
        bit
    }

    #[inline(always)]
    fn symbol_in(&mut self, registers: &mut Window, model: &mut SymbolModel, _: usize) -> usize {
        let part = registers.range >> PARTS_BITS;
        // Compares with all symbols: a search would often be mispredicted.
        let begins = |symbol: usize| registers.code >= part * u64::from(model.share(symbol)[0]);
        let symbol: usize = (1..SYMBOLS).map(|symbol| usize::from(begins(symbol))).sum();
        let [from, to] = model.share(symbol);
        registers.code -= part * u64::from(from);
        registers.range = part * u64::from(to - from);
        model.learn(symbol);
        self.widen(registers);
        symbol
    }
}

const fn high_word(value: u64) -> u32 {
    (value >> 32) as u32
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Bits with very uneven and with even probabilities. The uneven ones often drive the interval to its ends.
    fn bits(seed: u64, count: usize) -> impl Iterator<Item = (usize, bool)> {
        let mut state = seed;
        (0..count).map(move |_| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let context = usize::from(state >> 60 != 0);
            (context, if context == 0 { state >> 33 & 1 == 1 } else { state >> 33 & 0x3FF == 0 })
        })
    }

    #[test]
    fn bits_round_trip_and_use_up_the_slice() {
        for (seed, count) in (0..40).flat_map(|seed| [0, 1, 2, 50, 3000].map(|count| (seed, count))) {
            let (mut output, mut models) = (vec![9], [BitModel::EVEN; 2]);
            let mut encoder = RangeEncoder::new(&mut output);
            for (context, bit) in bits(seed, count) {
                encoder.bit(&mut models[context], bit);
            }
            let most = encoder.most_bytes();
            encoder.finish();
            assert!(output.len() - 1 <= most);
            let (mut decoder, mut models) = (RangeDecoder::new(&output[1..]), [BitModel::EVEN; 2]);
            for (context, bit) in bits(seed, count) {
                assert_eq!(decoder.bit(&mut models[context], false), bit);
            }
            assert!(decoder.is_at_end());
        }
    }

    #[test]
    fn rollback_leaves_no_trace() {
        for seed in 0..200 {
            let encode = |count: usize, detour: usize| {
                let (mut output, mut models) = (vec![], [BitModel::EVEN; 2]);
                let mut encoder = RangeEncoder::new(&mut output);
                for (context, bit) in bits(seed, count) {
                    encoder.bit(&mut models[context], bit);
                }
                let position = encoder.position();
                for (context, bit) in bits(seed + 7, detour) {
                    encoder.bit(&mut models[context], bit);
                }
                encoder.rollback(position);
                encoder.finish();
                output
            };
            assert_eq!(encode(300, 0), encode(300, 500));
        }
    }

    /// All ones take the interval's lower end, all zeros its upper end: carries run through words of ones.
    #[test]
    fn a_carry_runs_through_words_of_ones() {
        let certain = BitModel::from_packed(0x000F);
        let (mut output, mut state) = (vec![], certain);
        let mut encoder = RangeEncoder::new(&mut output);
        for _ in 0..200_000 {
            encoder.bit(&mut state, false);
        }
        let mut even = BitModel::EVEN;
        for place in 0..64 {
            encoder.bit(&mut even, place % 3 == 0);
        }
        encoder.finish();
        let (mut decoder, mut state, mut even) = (RangeDecoder::new(&output), certain, BitModel::EVEN);
        assert!((0..200_000).all(|_| !decoder.bit(&mut state, true)));
        assert!((0..64).all(|place| decoder.bit(&mut even, false) == (place % 3 == 0)));
        assert!(decoder.is_at_end());
        assert!(!RangeDecoder::new(&[0; 9]).is_at_end());
    }
}
