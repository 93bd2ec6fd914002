//! Adaptive probabilities of eight symbols, where a bit is too little.

use super::bit_model::SLOW;

pub(super) const SYMBOLS: usize = 8;

/// Parts of the interval that adapt.
const TOP: i16 = 0x7FC0;

/// Further parts that each symbol always has, so that none takes more than 12 bits.
const LEAST: u32 = 8;

/// Number of all parts, as a power of two.
pub(super) const PARTS_BITS: u32 = 15;

const _: () = assert!(TOP as u32 + 8 * LEAST == 1 << PARTS_BITS);

/// For each coded symbol, the values that the symbols' beginnings move towards.
const TARGETS: [[i16; SYMBOLS]; SYMBOLS] = {
    let mut targets = [[TOP; SYMBOLS]; SYMBOLS];
    let mut symbol = 0;
    while symbol < SYMBOLS {
        let mut bound = 0;
        while bound <= symbol {
            targets[symbol][bound] = 0;
            bound += 1;
        }
        symbol += 1;
    }
    targets
};

/// Where each symbol's share of the interval begins, without its [`LEAST`] parts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct SymbolModel([i16; SYMBOLS]);

impl SymbolModel {
    /// Equal shares.
    pub(super) const EVEN: Self = {
        let step = TOP / 8;
        Self([0, step, step * 2, step * 3, step * 4, step * 5, step * 6, step * 7])
    };

    /// No counts yet; see [`Self::count`].
    pub(super) const NONE: Self = Self([0; SYMBOLS]);

    /// `packed` is from `prior.bin`.
    pub(super) fn from_packed(packed: [u16; SYMBOLS]) -> Self {
        Self(packed.map(u16::cast_signed))
    }

    /// Returns where a symbol's share begins and ends. Branchless, because a branch would often be mispredicted.
    #[inline(always)]
    pub(super) fn share(&self, symbol: usize) -> [u32; 2] {
        #[expect(clippy::cast_possible_truncation, reason = "there are eight symbols")]
        // After the last symbol comes the first one's 0.
        let begins = |symbol: usize| u32::from(self.0[symbol % SYMBOLS].cast_unsigned()) + LEAST * (symbol as u32);
        [begins(symbol), begins(symbol + 1) + u32::from(symbol == SYMBOLS - 1) * u32::from(TOP.cast_unsigned())]
    }

    #[inline(always)]
    pub(super) fn learn(&mut self, symbol: usize) {
        for (begins, target) in self.0.iter_mut().zip(&TARGETS[symbol % SYMBOLS]) {
            *begins += (*target - *begins) >> SLOW;
        }
    }

    /// Counts a symbol, in a model that only counts: its numbers are then counts.
    pub(super) fn count(&mut self, symbol: usize) {
        self.0[symbol] += 1;
        if self.0[symbol] == i16::MAX {
            self.0.iter_mut().for_each(|count| *count /= 2);
        }
    }

    /// Returns the counted shares, as [`Self::from_packed`] takes them, or `None` without counts.
    pub(super) fn packed_count(&self) -> Option<[u16; SYMBOLS]> {
        let all: i64 = self.0.iter().map(|count| i64::from(*count)).sum();
        // Each symbol gets a twentieth of a count, for symbols not seen yet.
        let weight = |count: i64, symbols: i64| count * 20 + symbols;
        let mut packed = [0; SYMBOLS];
        let mut before = 0;
        for ((bound, symbols), count) in packed[1..].iter_mut().zip(1..).zip(self.0) {
            before += i64::from(count);
            *bound = u16::try_from(weight(before, symbols) * i64::from(TOP) / weight(all, 8)).unwrap_or(0);
        }
        (all > 0).then_some(packed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_symbol_keeps_a_share() {
        let mut choice = SymbolModel::EVEN;
        for step in 0..5000_usize {
            choice.learn(if step < 2000 {
                0
            } else if step < 4000 {
                7
            } else {
                step * step % 11 % 8
            });
            let mut end = 0;
            for symbol in 0..SYMBOLS {
                let [from, to] = choice.share(symbol);
                assert_eq!(from, end);
                assert!(to >= from + LEAST, "step {step}, symbol {symbol}");
                end = to;
            }
            assert_eq!(end, 1 << PARTS_BITS);
        }
    }

    #[test]
    fn counts_become_shares() {
        let mut counted = SymbolModel::NONE;
        assert_eq!(counted.packed_count(), None);
        (0..30).for_each(|step| counted.count(if step % 3 == 0 { 5 } else { 2 }));
        let choice = SymbolModel::from_packed(counted.packed_count().unwrap());
        let parts = |symbol: usize| choice.share(symbol)[1] - choice.share(symbol)[0];
        assert!((21_000..22_000).contains(&parts(2)) && (10_500..11_000).contains(&parts(5)), "{choice:?}");
    }
}
