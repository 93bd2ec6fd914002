//! The model of `tiles-small`: which bits are coded, and in what contexts.
//!
//! One bit says that the whole block is like the tile before it. If not, the kind of each tile follows, and each row of
//! each mixed tile ([`edges`]). Every slice begins with probabilities counted over other masks ([`super::prior`]).

use super::{
    bit_model::QUICK,
    block::{DecodedBlock, Extent, Kind},
    contexts::{BLOCK, TILE},
    edges,
    models::Models,
    neighbours::{Neighbours, UNKNOWN, code_rows, uniformity},
    range::BinaryCoder,
};

/// Codes a block. Returns the coded block; what a decoder passes in is ignored.
pub(super) fn code(
    bits: &mut impl BinaryCoder,
    models: &mut Models,
    neighbours: &Neighbours<'_>,
    block: &DecodedBlock,
) -> DecodedBlock {
    let own = block.extent;
    let above = neighbours.above.map(|above| above.extent);
    let other = neighbours.other.map(|other| other.extent);
    let left = neighbours.left.map(|left| left.extent.kind(7));
    let row_above = neighbours.above.map_or(0, |above| above.rows[7]);

    let predicted = match left {
        Some(Kind::Dark) => false,
        Some(Kind::Lit) => true,
        _ => row_above & 1 == 1,
    };
    let all = u64::from(predicted).wrapping_neg();
    let agrees = neighbours.above.is_some() && row_above == all;
    let context = usize::from(agrees)
        | usize::from(above.and_then(Extent::value) == Some(predicted)) << 1
        | left.map_or(UNKNOWN, |kind| kind as usize) << 2
        | usize::from(other.is_some_and(|other| other.value().is_some())) << 4;
    let mut registers = bits.registers();
    if bits.bit_in::<QUICK>(&mut registers, &mut models.bits[BLOCK.at(context)], own.value() == Some(predicted)) {
        bits.set_registers(registers);
        return DecodedBlock::flat(predicted);
    }

    let (mut mixed, mut lit) = (0_u64, 0_u64);
    let mut before = left.map_or(UNKNOWN, |kind| kind as usize);
    for tile in 0..neighbours.tiles {
        let kind = own.kind(tile);
        let over = above.map_or(5, |above| match above.kind(tile) {
            Kind::Mixed => 2 + uniformity(row_above >> (tile * 8)),
            kind => kind as usize,
        });
        let beyond = match (tile, neighbours.above, neighbours.above_right) {
            (0..7, Some(_), _) => uniformity(row_above >> (tile * 8 + 8)),
            (7, _, Some(right)) => uniformity(right.rows[7]),
            _ => UNKNOWN,
        };
        let beside = other.map_or(UNKNOWN, |other| other.kind(tile) as usize);
        let context = TILE.at(2 * (((over * 4 + beyond) * 4 + before) * 4 + beside));
        let byte = 0xFF << (tile * 8);
        before = if bits.bit_in::<QUICK>(&mut registers, &mut models.bits[context], kind == Kind::Mixed) {
            mixed |= byte;
            Kind::Mixed as usize
        } else if bits.bit_in::<QUICK>(&mut registers, &mut models.bits[context + 1], kind == Kind::Lit) {
            lit |= byte;
            Kind::Lit as usize
        } else {
            Kind::Dark as usize
        };
    }
    let known = code_rows(neighbours, &block.rows, mixed, lit, |part, truth| {
        edges::code(bits, &mut registers, models, part, truth)
    });
    bits.set_registers(registers);
    known
}
