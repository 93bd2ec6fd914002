//! The model of `tiles-small`: which bits a block takes, and in what contexts.
//!
//! First whether all of the block is as the tile before it, then what each tile holds, then each row of each mixed tile as
//! [`edges`] has it. Everything begins with what other masks have taught ([`super::prior`]).

use super::{
    block::{Extent, Kind, Known},
    choice::Choice,
    edges,
    near::{Near, UNKNOWN, code_rows, uniformity},
    prior::PRIOR_BITS,
    range::Bits,
    state::{QUICK, State},
    table::Table,
};

/// What is known in every context.
pub(super) struct States {
    pub(super) bits: Box<[State; BIT_CONTEXTS]>,
    pub(super) choices: Table<Choice, { edges::CHOICE_CONTEXTS }>,
}

impl States {
    /// Begins a slice.
    pub(super) fn begin(&mut self) {
        self.bits.clone_from(&PRIOR_BITS);
        self.choices.begin();
    }
}

/// Contexts of the tiles' bits: whether one is mixed, and whether it is lit.
const TILE: usize = 32;

/// The first of the contexts of the rows' bits, behind those of blocks and tiles.
const ROWS: usize = TILE + 2 * 384;

/// Contexts of bits.
pub(super) const BIT_CONTEXTS: usize = ROWS + edges::BIT_CONTEXTS;

/// Codes a block, and gives it back; a decoder is given any block.
pub(super) fn code(bits: &mut impl Bits, states: &mut States, near: &Near<'_>, block: &Known) -> Known {
    let own = block.extent;
    let above = near.above.map(|above| above.extent);
    let other = near.other.map(|other| other.extent);
    let left = near.left.map(|left| left.extent.kind(7));
    let row_above = near.above.map_or(0, |above| above.rows[7]);

    let expected = match left {
        Some(Kind::Dark) => false,
        Some(Kind::Lit) => true,
        _ => row_above & 1 == 1,
    };
    let all = u64::from(expected).wrapping_neg();
    let agrees = near.above.is_some() && row_above == all;
    let context = usize::from(agrees)
        | usize::from(above.and_then(Extent::value) == Some(expected)) << 1
        | left.map_or(UNKNOWN, |kind| kind as usize) << 2
        | usize::from(other.is_some_and(|other| other.value().is_some())) << 4;
    let mut hot = bits.hot();
    if bits.bit_in::<QUICK>(&mut hot, &mut states.bits[context], own.value() == Some(expected)) {
        bits.set_hot(hot);
        return Known::flat(expected);
    }

    let (mut mixed, mut lit) = (0_u64, 0_u64);
    let mut before = left.map_or(UNKNOWN, |kind| kind as usize);
    for tile in 0..near.tiles {
        let kind = own.kind(tile);
        let over = above.map_or(5, |above| match above.kind(tile) {
            Kind::Mixed => 2 + uniformity(row_above >> (tile * 8)),
            kind => kind as usize,
        });
        let beyond = match (tile, near.above, near.above_right) {
            (0..7, Some(_), _) => uniformity(row_above >> (tile * 8 + 8)),
            (7, _, Some(right)) => uniformity(right.rows[7]),
            _ => UNKNOWN,
        };
        let beside = other.map_or(UNKNOWN, |other| other.kind(tile) as usize);
        let context = TILE + 2 * (((over * 4 + beyond) * 4 + before) * 4 + beside);
        let byte = 0xFF << (tile * 8);
        before = if bits.bit_in::<QUICK>(&mut hot, &mut states.bits[context], kind == Kind::Mixed) {
            mixed |= byte;
            Kind::Mixed as usize
        } else if bits.bit_in::<QUICK>(&mut hot, &mut states.bits[context + 1], kind == Kind::Lit) {
            lit |= byte;
            Kind::Lit as usize
        } else {
            Kind::Dark as usize
        };
    }
    let known =
        code_rows(near, &block.rows, mixed, lit, |part, truth| edges::code(bits, &mut hot, states, ROWS, part, truth));
    bits.set_hot(hot);
    known
}
