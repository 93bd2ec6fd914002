//! What `tiles-small` knows before it has seen anything: the probabilities that it begins every slice with.
//!
//! They are the averages over masks of several scenes; the example `train_tiles` counts them anew. In `prior.bin` are the bits, two bytes a
//! context, and then those choices that came, with their contexts; in `refine.bin` the bits of slices with a reference.
//! A change of them is a change of the protocol.

use std::sync::LazyLock;

use super::{
    choice::{Choice, SYMBOLS},
    edges::CHOICE_CONTEXTS,
    range::Bits,
    refine::RefineStates,
    small::{BIT_CONTEXTS, States},
    state::State,
    table::Table,
};

static PACKED: &[u8] = include_bytes!("prior.bin");

/// Bytes of a choice: its context, and its eight numbers.
const CHOICE_BYTES: usize = 2 * (1 + SYMBOLS);

/// The bits' states at the beginning of a slice.
pub(super) static PRIOR_BITS: LazyLock<Box<[State; BIT_CONTEXTS]>> = LazyLock::new(|| {
    let mut states = Box::new([State::from_packed(0x8000); BIT_CONTEXTS]);
    for (state, packed) in states.iter_mut().zip(PACKED.as_chunks().0) {
        *state = unpack(*packed);
    }
    states
});

static PRIOR_CHOICES: LazyLock<Box<[Choice; CHOICE_CONTEXTS]>> = LazyLock::new(|| {
    let (packed, _) = PACKED.get(2 * BIT_CONTEXTS..).unwrap_or_default().as_chunks::<CHOICE_BYTES>();
    let mut choices = Box::new([Choice::EVEN; CHOICE_CONTEXTS]);
    for packed in packed {
        let [context, numbers @ ..] = packed.as_chunks().0 else { continue };
        let place = choices.get_mut(usize::from(u16::from_le_bytes(*context)));
        if let (Some(place), Some(numbers)) = (place, numbers.first_chunk()) {
            *place = Choice::from_packed(numbers.map(u16::from_le_bytes));
        }
    }
    choices
});

/// The states at the beginning of a slice with a reference.
pub(super) static REFINE_PRIOR: LazyLock<RefineStates> = LazyLock::new(|| {
    let mut states = RefineStates::blank();
    for (state, packed) in states.all().zip(include_bytes!("refine.bin").as_chunks().0) {
        *state = unpack(*packed);
    }
    states
});

fn unpack(packed: [u8; 2]) -> State {
    State::from_packed(u16::from_le_bytes(packed))
}

/// States for slices.
pub(super) fn states() -> States {
    States { bits: PRIOR_BITS.clone(), choices: Table::new(&PRIOR_CHOICES) }
}

/// States to count in.
pub(super) fn uncounted() -> States {
    States { bits: Box::new([State::NONE; BIT_CONTEXTS]), choices: Table::blank(Choice::NONE) }
}

/// Counts instead of coding.
pub(super) struct Counter;

impl Bits for Counter {
    type Hot = ();

    fn hot(&self) {}

    fn set_hot(&mut self, (): ()) {}

    fn bit_in<const RATE: u32>(&mut self, (): &mut (), state: &mut State, bit: bool) -> bool {
        state.count(bit);
        bit
    }

    fn choice_in(&mut self, (): &mut (), choice: &mut Choice, symbol: usize) -> usize {
        choice.count(symbol);
        symbol
    }
}

/// The file of what was counted with references.
pub(super) fn pack_refined(counted: &mut RefineStates) -> Vec<u8> {
    counted.all().flat_map(|state| state.packed_count().to_le_bytes()).collect()
}

/// The file of what was counted.
pub(super) fn pack(counted: &States) -> Vec<u8> {
    let bits = counted.bits.iter().flat_map(|state| state.packed_count().to_le_bytes());
    let choices = (0_u16..).zip(counted.choices.all()).filter_map(|(context, choice)| {
        let packed = choice.packed_count()?;
        Some(std::iter::once(context).chain(packed).flat_map(u16::to_le_bytes))
    });
    bits.chain(choices.flatten()).collect()
}
