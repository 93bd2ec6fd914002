//! The adaptive probabilities of `tiles-small`.

use super::{
    bit_model::BitModel,
    contexts::{BIT_CONTEXTS, SYMBOL_CONTEXTS},
    prior::{PRIOR_BITS, PRIOR_SYMBOLS},
    symbol_model::SymbolModel,
    table::Table,
};

pub(super) struct Models {
    pub(super) bits: Box<[BitModel; BIT_CONTEXTS]>,
    pub(super) symbols: Table<SymbolModel, SYMBOL_CONTEXTS>,
}

impl Models {
    pub(super) fn new() -> Self {
        Self { bits: PRIOR_BITS.clone(), symbols: Table::new(&PRIOR_SYMBOLS) }
    }

    /// Models that only count.
    pub(super) fn uncounted() -> Self {
        Self { bits: Box::new([BitModel::NONE; BIT_CONTEXTS]), symbols: Table::blank(SymbolModel::NONE) }
    }

    /// Resets to the prior, at the beginning of a slice.
    pub(super) fn begin_slice(&mut self) {
        self.bits.clone_from(&PRIOR_BITS);
        self.symbols.begin();
    }

    /// Returns the counts as the bytes of `prior.bin`.
    pub(super) fn pack(&self) -> Vec<u8> {
        let bits = self.bits.iter().flat_map(|model| model.packed_count().to_le_bytes());
        let symbols = (0_u16..).zip(self.symbols.all()).filter_map(|(context, model)| {
            let packed = model.packed_count()?;
            Some(std::iter::once(context).chain(packed).flat_map(u16::to_le_bytes))
        });
        bits.chain(symbols.flatten()).collect()
    }
}
