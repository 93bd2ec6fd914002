//! The probabilities that `tiles-small` begins every slice with.
//!
//! They are averages over masks of several scenes, counted by the example `train_tiles`. `prior.bin` holds the bits,
//! two bytes a context, and then the symbol models that occurred, each with its context; `refine.bin` the bits of
//! slices with a reference. Changing them changes the protocol.

use std::sync::LazyLock;

use super::{
    bit_model::BitModel,
    contexts::{BIT_CONTEXTS, SYMBOL_CONTEXTS},
    refine::RefineModels,
    symbol_model::{SYMBOLS, SymbolModel},
};

static PACKED: &[u8] = include_bytes!("prior.bin");

/// Bytes of a symbol model: its context and eight numbers.
const SYMBOL_BYTES: usize = 2 * (1 + SYMBOLS);

pub(super) static PRIOR_BITS: LazyLock<Box<[BitModel; BIT_CONTEXTS]>> = LazyLock::new(|| {
    let mut models = Box::new([BitModel::from_packed(0x8000); BIT_CONTEXTS]);
    for (model, packed) in models.iter_mut().zip(PACKED.as_chunks().0) {
        *model = unpack(*packed);
    }
    models
});

pub(super) static PRIOR_SYMBOLS: LazyLock<Box<[SymbolModel; SYMBOL_CONTEXTS]>> = LazyLock::new(|| {
    let (packed, _) = PACKED.get(2 * BIT_CONTEXTS..).unwrap_or_default().as_chunks::<SYMBOL_BYTES>();
    let mut symbols = Box::new([SymbolModel::EVEN; SYMBOL_CONTEXTS]);
    for packed in packed {
        let [context, numbers @ ..] = packed.as_chunks().0 else { continue };
        let place = symbols.get_mut(usize::from(u16::from_le_bytes(*context)));
        if let (Some(place), Some(numbers)) = (place, numbers.first_chunk()) {
            *place = SymbolModel::from_packed(numbers.map(u16::from_le_bytes));
        }
    }
    symbols
});

/// Models at the beginning of a slice with a reference.
pub(super) static REFINE_PRIOR: LazyLock<RefineModels> = LazyLock::new(|| {
    let mut models = RefineModels::blank();
    for (model, packed) in models.all().zip(include_bytes!("refine.bin").as_chunks().0) {
        *model = unpack(*packed);
    }
    models
});

fn unpack(packed: [u8; 2]) -> BitModel {
    BitModel::from_packed(u16::from_le_bytes(packed))
}
