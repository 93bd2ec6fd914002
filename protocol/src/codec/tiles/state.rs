//! How likely the next bit is: a probability for each context, which learns.

/// Smallest probability of either bit, of 65,536: no bit takes more than 12 bits.
const LEAST: i32 = 16;

/// How far the probability moves at the n-th bit, of 32,768: 1/(n + 1.6), as an average does.
const RATES: [i32; 32] = {
    let mut rates = [0; 32];
    let (mut seen, mut tenths) = (0, 16);
    while seen < rates.len() {
        rates[seen] = 327_680 / tenths;
        (seen, tenths) = (seen + 1, tenths + 10);
    }
    rates
};

/// Bits after which the rate stays.
const MOST_SEEN: u32 = 23;

/// How likely a bit is in some context: the probability of 1 (of 65,536) above, and how many bits it rests on below.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct State(u32);

impl State {
    /// Nothing counted.
    pub(super) const NONE: Self = Self(0);

    /// From a table: 12 bits of probability above, 4 of the number of bits below.
    pub(super) const fn from_packed(packed: u16) -> Self {
        let probability = (packed >> 4 << 4) as u32 | 8;
        Self(probability << 16 | (packed & 15) as u32)
    }

    /// Probability of 1, of 65,536.
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

    /// What was counted, as [`Self::from_packed`] takes it. It weighs as much as eight bits at most: a mask may differ.
    pub(super) fn packed_count(self) -> u16 {
        let (ones, all) = (self.one(), self.0 & 0xFFFF);
        // Krichevsky and Trofimov's estimate.
        let probability = (ones * 2 + 1) * 4096 / ((all + 1) * 2);
        let packed = probability.clamp(1, 4094) << 4 | all.min(8);
        u16::try_from(packed).unwrap_or(0x8000)
    }

    #[inline(always)]
    pub(super) fn learn(&mut self, bit: bool) {
        let seen = self.0 & 31;
        let target = if bit { 0x1_0000 - LEAST } else { LEAST };
        let old = self.one().cast_signed();
        let step = ((target - old) * RATES[seen as usize]) >> 15;
        self.0 = (old + step).cast_unsigned() << 16 | (seen + u32::from(seen < MOST_SEEN));
    }
}
