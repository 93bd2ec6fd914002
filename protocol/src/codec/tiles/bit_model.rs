//! An adaptive probability of a bit, one for each context.

/// Smallest probability of either bit, in 65,536ths: no bit takes more than 12 bits.
const LEAST: u32 = 16;

/// Shift of the adaptation rate. It can be slow from the first bit on, because the prior was counted over many masks.
pub(super) const SLOW: u32 = 5;

/// The same for models with few contexts, whose bits vary more between masks.
pub(super) const QUICK: u32 = 4;

/// Probability of a 1, in units of 2⁻³².
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct BitModel(u32);

impl BitModel {
    /// No counts yet; see [`Self::count`].
    pub(super) const NONE: Self = Self(0);

    #[cfg(test)]
    pub(super) const EVEN: Self = Self(1 << 31);

    /// `packed` is the probability of 1, in 65,536ths.
    pub(super) const fn from_packed(packed: u16) -> Self {
        Self((packed as u32) << 16)
    }

    /// Returns the probability of 1, in 65,536ths.
    #[inline(always)]
    pub(super) const fn one(self) -> u32 {
        self.0 >> 16
    }

    /// Counts a bit, in a model that only counts: the upper half holds the ones, the lower half all bits.
    pub(super) fn count(&mut self, bit: bool) {
        let (mut ones, mut all) = (self.one() + u32::from(bit), (self.0 & 0xFFFF) + 1);
        if all == 0xFFFF {
            (ones, all) = (ones / 2, all / 2);
        }
        self.0 = ones << 16 | all;
    }

    /// Returns the counted probability, as [`Self::from_packed`] takes it.
    pub(super) fn packed_count(self) -> u16 {
        let (ones, all) = (self.one(), self.0 & 0xFFFF);
        // Krichevsky and Trofimov's estimate.
        let probability = (u64::from(ones) * 2 + 1) * 65_536 / (u64::from(all + 1) * 2);
        u16::try_from(probability.clamp(u64::from(LEAST), u64::from(0x1_0000 - LEAST))).unwrap_or(0x8000)
    }

    /// Moves towards probability 1 or 0, but no closer than [`LEAST`] to either.
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
