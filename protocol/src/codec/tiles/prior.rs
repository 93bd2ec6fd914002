//! What `tiles-small` knows before it has seen anything: the probabilities that it begins every slice with.
//!
//! They are the averages over masks of several scenes, two bytes a context; the example `train_tiles` counts them anew.
//! A change of them is a change of the protocol.

use std::sync::LazyLock;

use super::{range::Bits, refine::RefineStates, small::States, state::State};

/// Contexts of the model.
const CONTEXTS: usize = 32 + 2 * 384 + 128 + 4096 + 1024;

static PACKED: &[u8; CONTEXTS * 2] = include_bytes!("prior.bin");

/// The states at the beginning of a slice.
pub(super) static PRIOR: States = {
    let mut states = blank();
    let mut next = 0;
    next = unpack(&mut states.block, next);
    let mut tile = 0;
    while tile < states.tile.len() {
        next = unpack(&mut states.tile[tile], next);
        tile += 1;
    }
    next = unpack(&mut states.flat, next);
    next = unpack(&mut states.pixel, next);
    next = unpack(&mut states.turn, next);
    assert!(next == CONTEXTS);
    states
};

static REFINE_PACKED: &[u8] = include_bytes!("refine.bin");

/// The states at the beginning of a slice with a reference.
pub(super) static REFINE_PRIOR: LazyLock<RefineStates> = LazyLock::new(|| {
    let mut states = RefineStates::blank();
    for (state, packed) in states.all().zip(REFINE_PACKED.as_chunks().0) {
        *state = State::from_packed(u16::from_le_bytes(*packed));
    }
    states
});

const fn blank() -> States {
    let none = State::NONE;
    States { block: [none; 32], tile: [[none; 2]; 384], flat: [none; 128], pixel: [none; 4096], turn: [none; 1024] }
}

const fn unpack(states: &mut [State], first: usize) -> usize {
    let mut index = 0;
    while index < states.len() {
        let at = (first + index) * 2;
        states[index] = State::from_packed(u16::from_le_bytes([PACKED[at], PACKED[at + 1]]));
        index += 1;
    }
    first + index
}

/// Counts instead of coding.
pub(super) struct Counter;

impl Bits for Counter {
    type Hot = ();

    fn hot(&self) {}

    fn set_hot(&mut self, (): ()) {}

    fn bit_in(&mut self, (): &mut (), state: &mut State, bit: bool) -> bool {
        state.count(bit);
        bit
    }
}

/// States to count in.
pub(super) fn uncounted() -> Box<States> {
    Box::new(blank())
}

/// The file of what was counted with references.
pub(super) fn pack_refined(counted: &mut RefineStates) -> Vec<u8> {
    counted.all().flat_map(|state| state.packed_count().to_le_bytes()).collect()
}

/// The file of what was counted.
pub(super) fn pack(counted: &States) -> Vec<u8> {
    let States { block, tile, flat, pixel, turn } = counted;
    let states = block.iter().chain(tile.as_flattened()).chain(flat).chain(pixel).chain(turn);
    states.flat_map(|state| state.packed_count().to_le_bytes()).collect()
}
