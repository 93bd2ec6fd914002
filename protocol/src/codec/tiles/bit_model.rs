//! How likely the next bit is: a probability for each context, which learns.

/// Smallest probability of either bit, of 65,536: no bit takes more than 12 bits.
const LEAST: u32 = 16;

/// How far the probability moves at each bit, as a power of two: what it begins with was counted over many masks, so it
/// need not move faster at first.
pub(super) const SLOW: u32 = 5;

/// The same where there are few contexts, and masks differ more.
pub(super) const QUICK: u32 = 4;

/// How likely a bit is in some context: the probability of 1, of 2³².
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct BitModel(u32);

impl BitModel {
    /// Nothing counted.
    pub(super) const NONE: Self = Self(0);

    /// Nothing known.
    #[cfg(test)]
    pub(super) const EVEN: Self = Self(1 << 31);

    /// From a table: the probability of 1, of 65,536.
    pub(super) const fn from_packed(packed: u16) -> Self {
        Self((packed as u32) << 16)
    }

    /// Probability of 1, of 65,536.
    #[inline(always)]
    pub(super) const fn one(self) -> u32 {
        self.0 >> 16
    }

    /// Counts a bit, in a state that is used for nothing else: how many were 1 above, how many there were below.
    pub(super) fn count(&mut self, bit: bool) {
        let (mut ones, mut all) = (self.one() + u32::from(bit), (self.0 & 0xFFFF) + 1);
        if all == 0xFFFF {
            (ones, all) = (ones / 2, all / 2);
        }
        self.0 = ones << 16 | all;
    }

    /// What was counted, as [`Self::from_packed`] takes it.
    pub(super) fn packed_count(self) -> u16 {
        let (ones, all) = (self.one(), self.0 & 0xFFFF);
        // Krichevsky and Trofimov's estimate.
        let probability = (u64::from(ones) * 2 + 1) * 65_536 / (u64::from(all + 1) * 2);
        u16::try_from(probability.clamp(u64::from(LEAST), u64::from(0x1_0000 - LEAST))).unwrap_or(0x8000)
    }

    /// Moves towards the probability 1 or 0, but not farther than [`LEAST`] from either.
    #[inline(always)]
    pub(super) fn learn<const RATE: u32>(&mut self, bit: bool) {
        let target = if bit { 0x1_0000 - LEAST } else { LEAST };
        self.0 = self.0 - (self.0 >> RATE) + (target << (16 - RATE));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_bit_becomes_impossible() {
        let mut state = BitModel::EVEN;
        for bit in [true, false] {
            (0..10_000).for_each(|_| state.learn::<SLOW>(bit));
            assert!((LEAST..=0x1_0000 - LEAST).contains(&state.one()));
            assert_eq!(state.one() > 65_000, bit);
        }
    }
}
