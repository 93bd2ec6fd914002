//! The model of `tiles-small`: which bits a block takes, and in what contexts.
//!
//! First whether all of the block is as the tile before it, then what each tile holds, then each row of each mixed tile: one
//! bit where nothing around it changes and it does not either, and its pixels otherwise. A pixel's context is JBIG2's
//! 10-pixel template (ITU-T T.88, §6.2.5.3) and whether the light before this one changes here, since silhouettes
//! are the same for all lights. Everything begins with what other masks have taught ([`super::prior`]).

use super::{
    block::{Extent, Kind, Known},
    near::{Near, Part, UNKNOWN, code_rows, uniformity},
    range::Bits,
    state::State,
};

/// Probabilities, for every context.
#[derive(Debug, Clone)]
pub(super) struct States {
    pub(super) block: [State; 32],
    pub(super) tile: [[State; 2]; 384],
    pub(super) flat: [State; 128],
    pub(super) pixel: [State; 4096],
    /// Of rows that change where nothing around them does.
    pub(super) turn: [State; 1024],
}

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
    if bits.bit(&mut states.block[context], own.value() == Some(expected)) {
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
        let states = &mut states.tile[((over * 4 + beyond) * 4 + before) * 4 + beside];
        let byte = 0xFF << (tile * 8);
        before = if bits.bit(&mut states[0], kind == Kind::Mixed) {
            mixed |= byte;
            Kind::Mixed as usize
        } else if bits.bit(&mut states[1], kind == Kind::Lit) {
            lit |= byte;
            Kind::Lit as usize
        } else {
            Kind::Dark as usize
        };
    }
    code_rows(near, &block.rows, mixed, lit, |part, truth| part.code(bits, states, truth))
}

impl Part<'_> {
    fn code(&self, bits: &mut impl Bits, states: &mut States, truth: u32) -> u32 {
        match (self.above, self.before) {
            ([0, 0], 0) => self.code_flat(bits, states, truth, 0),
            ([0xFFF, 0x3FF], 3) => self.code_flat(bits, states, truth, 0xFF),
            _ => {
                let other = self.changes();
                self.code_pixels(bits, &mut states.pixel, truth, |x, template| {
                    template | (other[0] >> x & 1) << 10 | (other[1] >> x & 1) << 11
                })
            }
        }
    }

    fn code_flat(&self, bits: &mut impl Bits, states: &mut States, truth: u32, value: u32) -> u32 {
        let state = &mut states.flat[self.surroundings() << 1 | usize::from(value != 0)];
        if bits.bit(state, truth == value) {
            return value;
        }
        self.code_pixels(bits, &mut states.turn, truth, |_, template| template)
    }

    #[inline(always)]
    fn code_pixels<const CONTEXTS: usize>(
        &self,
        bits: &mut impl Bits,
        states: &mut [State; CONTEXTS],
        truth: u32,
        context: impl Fn(u32, u32) -> u32,
    ) -> u32 {
        let (mut coded, mut before, mut hot) = (0, self.before, bits.hot());
        for x in 0..8 {
            let template = self.above[0] >> x & 0x1F | (self.above[1] >> x & 7) << 5 | before << 8;
            let state = &mut states[context(x, template) as usize % CONTEXTS];
            let bit = u32::from(bits.bit_in(&mut hot, state, truth >> x & 1 == 1));
            coded |= bit << x;
            before = before >> 1 | bit << 1;
        }
        bits.set_hot(hot);
        coded
    }
}
