//! Prefix codes for `tiles-fast`: a fixed one for each context, of at most 7 bits (short) or 10 bits (long).
//!
//! Frequent symbols have their own code; all others are an escape and 8 bits. The codes are canonical. `codes.bin`
//! holds their lengths, which the example `train_tiles` counts over masks of several scenes. Changing it changes the
//! protocol.

use std::sync::LazyLock;

use super::{
    bits::{BitReader, BitWriter},
    fast::{LONG_CONTEXTS, SHORT_CONTEXTS, SymbolCoder},
};

/// The escape's symbol, after all symbols that it replaces.
const ESCAPE: usize = 256;

static LENGTHS: &[u8] = include_bytes!("codes.bin");

pub(super) static CODES: LazyLock<Codes> = LazyLock::new(|| Codes::from_lengths(LENGTHS));

pub(super) struct Codes {
    pub(super) short: Set<7>,
    pub(super) long: Set<10>,
}

impl Codes {
    /// `bytes` holds the short codes' lengths first: for each context the number of symbols, each symbol with its
    /// length, and the escape's length.
    fn from_lengths(mut bytes: &[u8]) -> Self {
        Self {
            short: Set::from_lengths(SHORT_CONTEXTS, &mut bytes),
            long: Set::from_lengths(LONG_CONTEXTS, &mut bytes),
        }
    }
}

/// A decoder's table entry: the symbol in the low byte, above it the bits that it takes, and [`ESCAPES`] at the top. It
/// is 16 bits so that the tables stay in the core's cache.
#[derive(Debug, Clone, Copy, Default)]
struct Entry(u16);

const ESCAPES: u16 = 1 << 15;

impl Entry {
    fn new(symbol: usize, bits: u8) -> Self {
        let [low, ..] = symbol.to_le_bytes();
        Self(u16::from_le_bytes([low, bits]) | if symbol == ESCAPE { ESCAPES } else { 0 })
    }

    const fn bits(self) -> u32 {
        (self.0 >> 8 & 0x7F) as u32
    }

    const fn symbol(self) -> u8 {
        let [symbol, _] = self.0.to_le_bytes();
        symbol
    }
}

/// Codes of at most `MOST_BITS` bits.
pub(super) struct Set<const MOST_BITS: u32> {
    /// Code bits and, above them, their number, by context and symbol; 0 if a symbol has no code of its own.
    write: Box<[[u16; ESCAPE]]>,
    /// The escape's code, by context.
    escapes: Box<[u16]>,
    /// Entries by context and the next `MOST_BITS` bits.
    read: Box<[Entry]>,
}

/// Place of the number of bits, above the code.
const COUNT_SHIFT: u32 = 12;

impl<const MOST_BITS: u32> Set<MOST_BITS> {
    fn from_lengths(contexts: usize, bytes: &mut &[u8]) -> Self {
        let (mut write, mut escapes, mut read) = (Vec::with_capacity(contexts), Vec::new(), Vec::new());
        let mut next = || {
            let (first, rest) = bytes.split_first().unwrap_or((&1, &[]));
            *bytes = rest;
            *first
        };
        for _ in 0..contexts {
            let mut lengths = [0; ESCAPE + 1];
            for _ in 0..u16::from_le_bytes([next(), next()]) {
                let symbol = usize::from(next());
                lengths[symbol] = next();
            }
            lengths[ESCAPE] = next();
            let [codes @ .., escape] = tables(&lengths, MOST_BITS, &mut read);
            write.push(codes);
            escapes.push(escape);
        }
        Self { write: write.into(), escapes: escapes.into(), read: read.into() }
    }

    #[inline(always)]
    pub(super) fn write(&self, output: &mut BitWriter<'_>, context: usize, symbol: u8) {
        let own = self.write[context][usize::from(symbol)];
        let code = u32::from(if own == 0 { self.escapes[context] } else { own });
        let (bits, count) = (code & ((1 << COUNT_SHIFT) - 1), code >> COUNT_SHIFT);
        if own == 0 {
            output.put(bits << 8 | u32::from(symbol), count + 8);
        } else {
            output.put(bits, count);
        }
    }

    #[inline(always)]
    pub(super) fn read(&self, input: &mut BitReader<'_>, context: usize) -> u8 {
        let entry = self.read[context << MOST_BITS | input.peek(MOST_BITS)];
        input.skip(entry.bits());
        if entry.0 & ESCAPES != 0 {
            let symbol = input.peek(8).to_le_bytes()[0];
            input.skip(8);
            return symbol;
        }
        entry.symbol()
    }
}

/// Returns canonical codes: shorter ones first, and among equally long ones lower symbols first. Appends the decoder's
/// entries to `read`.
fn tables(lengths: &[u8; ESCAPE + 1], most_bits: u32, read: &mut Vec<Entry>) -> [u16; ESCAPE + 1] {
    let mut codes = [0; ESCAPE + 1];
    let (start, places) = (read.len(), 1 << most_bits);
    read.resize(start + places, Entry::default());
    // The first free entry, and the code that it belongs to.
    let (mut place, mut code) = (start, 0_u16);
    for bits in 1..=most_bits {
        code <<= 1;
        let symbols = (0..).zip(lengths).filter(|(_, length)| u32::from(**length) == bits);
        for (symbol, length) in symbols {
            codes[symbol] = code | u16::from(*length) << COUNT_SHIFT;
            let next = place + (places >> bits);
            read[place..next].fill(Entry::new(symbol, *length));
            (place, code) = (next, code + 1);
        }
    }
    codes
}

pub(super) struct SymbolWriter<'a, 'b>(pub(super) &'a mut BitWriter<'b>, pub(super) &'a Codes);

impl SymbolCoder for SymbolWriter<'_, '_> {
    #[inline(always)]
    fn short(&mut self, context: usize, symbol: u8) -> u8 {
        self.1.short.write(self.0, context, symbol);
        symbol
    }

    #[inline(always)]
    fn long(&mut self, context: usize, symbol: u8) -> u8 {
        self.1.long.write(self.0, context, symbol);
        symbol
    }
}

pub(super) struct SymbolReader<'a, 'b>(pub(super) &'a mut BitReader<'b>, pub(super) &'a Codes);

impl SymbolCoder for SymbolReader<'_, '_> {
    #[inline(always)]
    fn short(&mut self, context: usize, _: u8) -> u8 {
        self.1.short.read(self.0, context)
    }

    #[inline(always)]
    fn long(&mut self, context: usize, _: u8) -> u8 {
        self.1.long.read(self.0, context)
    }
}

/// How often each symbol occurred in each context.
pub(super) struct Counts {
    pub(super) short: Vec<[u64; ESCAPE]>,
    pub(super) long: Vec<[u64; ESCAPE]>,
}

impl Counts {
    pub(super) fn new() -> Self {
        Self { short: vec![[0; ESCAPE]; SHORT_CONTEXTS], long: vec![[0; ESCAPE]; LONG_CONTEXTS] }
    }

    /// Returns the bytes of `codes.bin`.
    pub(super) fn pack(&self) -> Vec<u8> {
        let mut bytes = pack(&self.short, 7);
        bytes.extend(pack(&self.long, 10));
        bytes
    }
}

/// Returns the packed lengths of codes of at most `most_bits` bits.
fn pack(counts: &[[u64; ESCAPE]], most_bits: u32) -> Vec<u8> {
    let mut bytes = Vec::new();
    for counts in counts {
        let total: u64 = counts.iter().sum();
        // For a rare symbol a long code is no better than a short escape and 8 bits.
        let mut symbols: Vec<usize> = (0..ESCAPE).filter(|symbol| counts[*symbol] << (most_bits + 2) > total).collect();
        // At most half of the possible codes, so that the lengths can be limited.
        symbols.sort_by_key(|symbol| std::cmp::Reverse(counts[*symbol]));
        symbols.truncate(1 << (most_bits - 1));
        symbols.sort_unstable();
        let escaped = total - symbols.iter().map(|symbol| counts[*symbol]).sum::<u64>();
        let symbols = if symbols.is_empty() { vec![0] } else { symbols };
        let mut weights: Vec<u64> = symbols.iter().map(|symbol| counts[*symbol] + 1).collect();
        weights.push(escaped + 1);
        let lengths = limited_lengths(weights, most_bits);
        bytes.extend(&symbols.len().to_le_bytes()[..2]);
        for (symbol, length) in symbols.iter().zip(&lengths) {
            bytes.extend([symbol.to_le_bytes()[0], *length]);
        }
        bytes.extend(lengths.last());
    }
    bytes
}

/// Returns Huffman code lengths, after evening out the weights until no code is too long.
fn limited_lengths(mut weights: Vec<u64>, most_bits: u32) -> Vec<u8> {
    loop {
        let mut lengths = vec![0; weights.len()];
        let mut trees: Vec<(u64, Vec<usize>)> = weights.iter().copied().zip((0..).map(|leaf| vec![leaf])).collect();
        while trees.len() > 1 {
            trees.sort_by_key(|(weight, _)| std::cmp::Reverse(*weight));
            if let (Some((a, mut left)), Some((b, right))) = (trees.pop(), trees.pop()) {
                left.extend(right);
                left.iter().for_each(|leaf| lengths[*leaf] += 1);
                trees.push((a + b, left));
            }
        }
        if lengths.iter().all(|length| u32::from(*length) <= most_bits) {
            return lengths;
        }
        weights.iter_mut().for_each(|weight| *weight = *weight / 2 + 1);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check<const MOST_BITS: u32>(set: &Set<MOST_BITS>, contexts: usize) {
        assert!(set.read.iter().all(|entry| entry.bits() > 0));
        assert_eq!(set.read.len(), contexts << MOST_BITS);
        for (context, symbol) in (0..contexts).flat_map(|context| (0..=255).map(move |symbol| (context, symbol))) {
            let mut output = Vec::new();
            let mut writer = BitWriter::new(&mut output);
            set.write(&mut writer, context, symbol);
            writer.finish();
            let mut reader = BitReader::new(&output);
            assert_eq!(set.read(&mut reader, context), symbol);
            assert!(reader.is_at_end());
        }
    }

    #[test]
    fn every_context_has_a_complete_code() {
        check(&CODES.short, SHORT_CONTEXTS);
        check(&CODES.long, LONG_CONTEXTS);
    }

    #[test]
    fn frequent_symbols_have_short_codes() {
        let mut counts = [0; ESCAPE];
        (counts[0], counts[7], counts[200]) = (1000, 200, 1);
        assert_eq!(pack(&[counts], 7), [2, 0, 0, 1, 7, 2, 2]);
        let codes = limited_lengths((0..30).map(|n| 1 << n).collect(), 7);
        assert!(codes.iter().all(|bits| *bits <= 7));
        assert_eq!(codes.iter().map(|bits| 1 << (7 - bits)).sum::<u32>(), 128);
    }
}
