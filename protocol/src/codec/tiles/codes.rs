//! Prefix codes for `tiles-fast`: one for each context, fixed, and at most 7 bits long.
//!
//! What was frequent has a code of its own; all else is an escape and 8 bits. The codes are canonical: `codes.bin` holds
//! their lengths, as the example `train_tiles` counted them over masks of several scenes. A change of them is a change of
//! the protocol.

use std::sync::LazyLock;

use super::{
    bits::{BitReader, BitWriter},
    fast::CONTEXTS,
};

/// Longest code in bits.
const MOST_BITS: u32 = 7;

/// Places of a decoding table.
const PLACES: usize = 1 << MOST_BITS;

/// The symbol of the escape, behind all that it stands for.
const ESCAPE: usize = 256;

static LENGTHS: &[u8] = include_bytes!("codes.bin");

/// The codes of all contexts.
pub(super) static CODES: LazyLock<Codes> = LazyLock::new(|| Codes::from_lengths(LENGTHS));

/// What a decoder finds under the next 7 bits.
#[derive(Debug, Clone, Copy, Default)]
struct Entry {
    symbol: u8,
    bits: u8,
    escapes: bool,
}

/// Codes of every context.
pub(super) struct Codes {
    /// Bits, and their number above them, by context and symbol.
    write: Box<[[u32; ESCAPE]]>,
    read: Box<[[Entry; PLACES]]>,
}

impl Codes {
    /// From the lengths: for each context the number of symbols, each symbol with its length, and the escape's length.
    fn from_lengths(mut bytes: &[u8]) -> Self {
        let (mut write, mut read) = (Vec::with_capacity(CONTEXTS), Vec::with_capacity(CONTEXTS));
        let mut next = || {
            let (first, rest) = bytes.split_first().unwrap_or((&1, &[]));
            bytes = rest;
            *first
        };
        for _ in 0..CONTEXTS {
            let mut lengths = [0; ESCAPE + 1];
            for _ in 0..next() {
                let symbol = usize::from(next());
                lengths[symbol] = next();
            }
            lengths[ESCAPE] = next();
            let (writing, reading) = tables(&lengths);
            write.push(writing);
            read.push(reading);
        }
        Self { write: write.into(), read: read.into() }
    }

    #[inline(always)]
    pub(super) fn write(&self, output: &mut BitWriter<'_>, context: usize, symbol: u8) {
        let code = self.write[context][usize::from(symbol)];
        output.put(code & 0xFFFF, code >> 16);
    }

    #[inline(always)]
    pub(super) fn read(&self, input: &mut BitReader<'_>, context: usize) -> u8 {
        let entry = self.read[context][input.peek::<MOST_BITS>()];
        input.skip(entry.bits.into());
        if entry.escapes {
            let symbol = input.peek::<8>().to_le_bytes()[0];
            input.skip(8);
            return symbol;
        }
        entry.symbol
    }
}

/// Canonical codes: shorter ones first, and among those of one length the lower symbols.
fn tables(lengths: &[u8; ESCAPE + 1]) -> ([u32; ESCAPE], [Entry; PLACES]) {
    let (mut codes, mut read) = ([0; ESCAPE + 1], [Entry::default(); PLACES]);
    // The first place that is free, and the same as a number for the codes.
    let (mut place, mut code) = (0, 0_u32);
    for bits in 1..=MOST_BITS {
        code <<= 1;
        let symbols = (0..).zip(lengths).filter(|(_, length)| u32::from(**length) == bits);
        for (symbol, length) in symbols {
            codes[symbol] = code | bits << 16;
            let entry = Entry { symbol: symbol.to_le_bytes()[0], bits: *length, escapes: symbol == ESCAPE };
            let next = place + (PLACES >> bits);
            read[place..next].fill(entry);
            (place, code) = (next, code + 1);
        }
    }
    let escape = codes[ESCAPE];
    let mut write = [0; ESCAPE];
    for ((symbol, write), code) in (0..).zip(&mut write).zip(codes) {
        *write = if code == 0 { (escape & 0xFFFF) << 8 | symbol | ((escape >> 16) + 8) << 16 } else { code };
    }
    (write, read)
}

/// The file of the lengths, from how often each symbol came in each context.
pub(super) fn pack(counts: &[[u64; ESCAPE]]) -> Vec<u8> {
    let mut bytes = Vec::new();
    for counts in counts {
        let total: u64 = counts.iter().sum();
        // A code of 7 bits and more is no better than the escape's 8 bits behind a short code, for what is rare.
        let own = |symbol: &usize| counts[*symbol] * 500 > total;
        let symbols: Vec<usize> = (0..ESCAPE).filter(own).collect();
        let escaped = total - symbols.iter().map(|symbol| counts[*symbol]).sum::<u64>();
        let symbols = if symbols.is_empty() { vec![0] } else { symbols };
        let mut weights: Vec<u64> = symbols.iter().map(|symbol| counts[*symbol] + 1).collect();
        weights.push(escaped + 1);
        let lengths = limited_lengths(weights);
        bytes.push(symbols.len().to_le_bytes()[0]);
        for (symbol, length) in symbols.iter().zip(&lengths) {
            bytes.extend([symbol.to_le_bytes()[0], *length]);
        }
        bytes.extend(lengths.last());
    }
    bytes
}

/// Huffman's lengths, after the weights have been brought together until no code is too long.
fn limited_lengths(mut weights: Vec<u64>) -> Vec<u8> {
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
        if lengths.iter().all(|length| u32::from(*length) <= MOST_BITS) {
            return lengths;
        }
        weights.iter_mut().for_each(|weight| *weight = *weight / 2 + 1);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_context_has_a_complete_code() {
        let codes = &*CODES;
        assert_eq!(codes.read.len(), CONTEXTS);
        for (context, read) in codes.read.iter().enumerate() {
            assert!(read.iter().all(|entry| entry.bits > 0), "context {context}");
            for symbol in 0..=255 {
                let mut output = Vec::new();
                let mut writer = BitWriter::new(&mut output);
                codes.write(&mut writer, context, symbol);
                writer.finish();
                let mut reader = BitReader::new(&output);
                assert_eq!(codes.read(&mut reader, context), symbol);
                assert!(reader.is_at_end());
            }
        }
    }

    #[test]
    fn frequent_symbols_have_short_codes() {
        let mut counts = [0; ESCAPE];
        (counts[0], counts[7], counts[200]) = (1000, 200, 1);
        assert_eq!(pack(&[counts]), [2, 0, 1, 7, 2, 2]);
        let codes = limited_lengths((0..30).map(|n| 1 << n).collect());
        assert!(codes.iter().all(|bits| *bits <= 7));
        assert_eq!(codes.iter().map(|bits| 1 << (7 - bits)).sum::<u32>(), 128);
    }
}
