//! The model of differences from a moved reference: which bits are coded, and in what contexts.
//!
//! For each place one bit says whether all lights are as predicted. If not, the vector follows, and a bit for each
//! light whose block is as predicted. Other blocks code which tiles are not, and their rows: one bit if nothing around
//! a row changes; else one bit for all pixels around which nothing changes, and one for each other pixel. Its context
//! is JBIG2's refinement template (ITU-T T.88, §6.3.5.3: three pixels above, one left, nine around it in the reference)
//! and the previous light's errors.

use super::{
    bit_model::{BitModel, SLOW},
    block::{Block, DecodedBlock, Kind},
    motion::{AxisModels, MotionModels},
    neighbours::Neighbours,
    range::BinaryCoder,
    reference::Line,
};

#[derive(Debug, Clone)]
pub(super) struct RefineModels {
    pub(super) place: [BitModel; 18],
    pub(super) motion: MotionModels,
    pub(super) block: [BitModel; 54],
    pub(super) tile: [BitModel; 162],
    pub(super) kind: [[BitModel; 2]; 12],
    pub(super) still: [BitModel; 24],
    /// The steady pixels of a row are like their surroundings.
    pub(super) steady: [BitModel; 16],
    pub(super) pixel: [BitModel; PIXELS],
}

const PIXELS: usize = 1 << 15;

/// The context of neighbours outside the slice.
pub(super) const UNKNOWN: usize = 2;

/// For each neighbour in the slice, a bit per tile that is as predicted.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Agreement {
    pub(super) above: Option<u8>,
    pub(super) left: Option<u8>,
    /// The previous light.
    pub(super) other: Option<u8>,
}

fn whole(tiles: Option<u8>) -> usize {
    tiles.map_or(UNKNOWN, |tiles| usize::from(tiles == u8::MAX))
}

/// Codes whether a block is as predicted.
pub(super) fn code_block(
    bits: &mut impl BinaryCoder,
    models: &mut RefineModels,
    agreement: Agreement,
    predicted: &DecodedBlock,
    truth: bool,
) -> bool {
    let Agreement { above, left, other } = agreement;
    let mixed = usize::from(predicted.extent.value().is_none());
    let context = ((whole(above) * 3 + whole(left)) * 3 + whole(other)) * 2 + mixed;
    bits.bit(&mut models.block[context], truth)
}

pub(super) struct Prediction<'a> {
    /// The predicted rows, with one above and one below.
    pub(super) lines: [Line; 10],
    pub(super) block: &'a DecodedBlock,
    /// Mispredicted pixels of the previous light.
    pub(super) wrong: Option<&'a Block>,
}

/// Codes a block that is not as predicted. Returns it, and a bit per tile that is; a decoder ignores `block`.
pub(super) fn code(
    bits: &mut impl BinaryCoder,
    models: &mut RefineModels,
    neighbours: &Neighbours<'_>,
    agreement: Agreement,
    prediction: &Prediction<'_>,
    block: &DecodedBlock,
) -> (DecodedBlock, u8) {
    let &Prediction { lines, block: predicted, wrong } = prediction;
    let bit_of = |tiles: Option<u8>, tile: usize| tiles.map_or(UNKNOWN, |tiles| usize::from(tiles >> tile & 1));
    let (mut equal, mut mixed, mut filled) = (u8::MAX, 0_u64, 0_u64);
    let mut before = bit_of(agreement.left, 7);
    for tile in 0..neighbours.tiles {
        let byte = 0xFF << (tile * 8);
        let from = predicted.extent.kind(tile);
        let context = (bit_of(agreement.above, tile) * 3 + before) * 3 + bit_of(agreement.other, tile);
        let differs = predicted.rows.iter().zip(&block.rows).any(|(predicted, own)| (predicted ^ own) & byte != 0);
        before = usize::from(bits.bit(&mut models.tile[context * 3 + from as usize], !differs));
        if before == 1 {
            continue;
        }
        equal &= !(1 << tile);
        let beyond = bit_of(agreement.above, (tile + 1).min(7)).min(1) + 2 * bit_of(agreement.other, tile).min(1);
        let models = &mut models.kind[from as usize * 4 + beyond];
        let kind = block.extent.kind(tile);
        if bits.bit(&mut models[0], kind == Kind::Mixed) {
            mixed |= byte;
        } else {
            let lit = match from {
                Kind::Dark => true,
                Kind::Lit => false,
                Kind::Mixed => bits.bit(&mut models[1], kind == Kind::Lit),
            };
            filled |= if lit { byte } else { 0 };
        }
    }
    // Pixels of tiles that are not as predicted.
    let differing = (0..8).filter(|tile| equal >> tile & 1 == 0).fold(0_u64, |bits, tile| bits | 0xFF << (tile * 8));

    let mut rows = [0; 8];
    let mut above = neighbours.above.map_or(lines[0], |above| {
        let [left, right] = lines[0].ends();
        Line::new(
            neighbours.above_left.map_or(left, |above| above.rows[7] >> 63),
            above.rows[7],
            neighbours.above_right.map_or(right, |above| above.rows[7]),
        )
    });
    for (place, row) in rows.iter_mut().enumerate() {
        let [line_left, line_right] = lines[place + 1].ends();
        let left = neighbours.left.map_or(line_left, |left| left.rows[place] >> 63);
        let beside = wrong.map_or(0, |wrong| wrong[place]);
        let (mut coded, mut rest) = (lines[place + 1].row() & !differing | filled, mixed);
        while rest != 0 {
            let shift = rest.trailing_zeros() & 0x38;
            rest &= !(0xFF << shift);
            let template = Template {
                above: above.window(shift),
                lines: [lines[place].window(shift), lines[place + 1].window(shift), lines[place + 2].window(shift)],
                before: byte_of((coded << 1 | left) >> shift) & 1,
                other: byte_of(beside >> shift) | byte_of(beside >> 1 >> shift) << 8,
            };
            let own = byte_of(block.rows[place] >> shift);
            let still = template.stillness().map(|value| {
                let beside = wrong.map_or(UNKNOWN, |_| usize::from(template.other & 0xFF != 0));
                (place * 3 + beside, value)
            });
            let byte = match still {
                Some((context, value)) if bits.bit(&mut models.still[context], own == value) => value,
                Some(_) => template.code(bits, &mut models.pixel, own),
                None => template.code_changing(bits, models, own),
            };
            coded |= u64::from(byte) << shift;
        }
        *row = coded;
        above = Line::new(left, coded, line_right);
    }
    (DecodedBlock::new(rows), equal)
}

#[expect(clippy::cast_possible_truncation, reason = "the lowest byte is wanted")]
const fn byte_of(word: u64) -> u32 {
    word as u32 & 0xFF
}

/// Pixels around which nothing changes: they are nearly always like their surroundings.
#[derive(Debug, Clone, Copy)]
struct Steady {
    pixels: u32,
    /// Those whose surroundings are lit.
    lit: u32,
}

/// Known surroundings of eight pixels.
struct Template {
    /// The row above, with one pixel more at either end.
    above: u32,
    /// The row above, this row and the row below in the reference.
    lines: [u32; 3],
    /// The pixel to the left.
    before: u32,
    /// Mispredicted pixels of the previous light, and in the next byte those one to the right of each.
    other: u32,
}

impl Template {
    /// Returns the value of all pixels around, or `None` if they differ.
    fn stillness(&self) -> Option<u32> {
        let [over, same, under] = self.lines;
        let all = self.before.wrapping_neg() & 0x3FF;
        (over == all && same == all && under == all && self.above == all).then_some(all & 0xFF)
    }

    /// Returns the pixels around which nothing changes, above or in the reference, and where the previous light was as
    /// predicted.
    #[inline(always)]
    fn steady(&self) -> Steady {
        let [over, same, under] = self.lines;
        let three = |row: u32| row & row >> 1 & row >> 2 & !self.other & 0xFF;
        let lit = three(over & same & under & self.above);
        Steady { pixels: lit | three(!(over | same | under | self.above)), lit }
    }

    /// One bit says that all steady pixels, about half of all, are as expected.
    fn code_changing(&self, bits: &mut impl BinaryCoder, models: &mut RefineModels, truth: u32) -> u32 {
        let steady = self.steady();
        if steady.pixels != 0 {
            let beside = self.other & 0xFF != 0;
            let of = (steady.pixels.count_ones() - 1) << 1 | u32::from(beside);
            if bits.bit(&mut models.steady[of as usize % 16], (truth ^ steady.lit) & steady.pixels == 0) {
                return self.code_unsteady(bits, &mut models.pixel, truth, steady);
            }
        }
        self.code(bits, &mut models.pixel, truth)
    }

    #[inline(always)]
    fn code_unsteady(
        &self,
        bits: &mut impl BinaryCoder,
        models: &mut [BitModel; PIXELS],
        truth: u32,
        steady: Steady,
    ) -> u32 {
        // `coded` starts with the pixel to the left.
        let (quarters, mut registers) = (self.quarters(), bits.registers());
        let (mut coded, mut rest) = (steady.lit << 1 | self.before, !steady.pixels & 0xFF);
        while rest != 0 {
            let x = rest.trailing_zeros();
            rest &= rest - 1;
            let model = &mut models[self.context(quarters, x, coded >> x & 1) % PIXELS];
            coded |= u32::from(bits.bit_in::<SLOW>(&mut registers, model, truth >> x & 1 == 1)) << (x + 1);
        }
        bits.set_registers(registers);
        coded >> 1
    }

    /// Returns the rows, each in a quarter of a word. Three pixels of each make a context.
    #[inline(always)]
    const fn quarters(&self) -> u64 {
        let [over, same, under] = self.lines;
        over as u64 | (same as u64) << 16 | (under as u64) << 32 | (self.above as u64) << 48
    }

    /// Returns the context of pixel `x`; `before` is the pixel to its left.
    #[inline(always)]
    fn context(&self, quarters: u64, x: u32, before: u32) -> usize {
        // The product joins the four triples in its top bits.
        let triples = (quarters >> x & 0x0007_0007_0007_0007).wrapping_mul(1 << 48 | 1 << 35 | 1 << 22 | 1 << 9) >> 48;
        let other = self.other >> x & 0x101;
        (triples as usize & 0xFFF) | (before << 12 | ((other | other >> 7) & 3) << 13) as usize
    }

    #[inline(always)]
    fn code(&self, bits: &mut impl BinaryCoder, models: &mut [BitModel; PIXELS], truth: u32) -> u32 {
        let (quarters, mut registers) = (self.quarters(), bits.registers());
        let (mut coded, mut before) = (0, self.before);
        for x in 0..8 {
            let model = &mut models[self.context(quarters, x, before) % PIXELS];
            before = u32::from(bits.bit_in::<SLOW>(&mut registers, model, truth >> x & 1 == 1));
            coded |= before << x;
        }
        bits.set_registers(registers);
        coded
    }
}

impl RefineModels {
    /// Returns all models, in the order of `refine.bin`.
    pub(super) fn all(&mut self) -> impl Iterator<Item = &mut BitModel> {
        let Self { place, motion: MotionModels { own, axes }, block, tile, kind, still, steady, pixel } = self;
        let axes = axes.iter_mut().flat_map(|AxisModels { differs, negative, longer, rest }| {
            differs.iter_mut().chain([negative]).chain(longer).chain(rest)
        });
        let few = place.iter_mut().chain(own).chain(axes).chain(block).chain(tile);
        few.chain(kind.as_flattened_mut()).chain(still).chain(steady).chain(pixel)
    }

    pub(super) const fn blank() -> Self {
        let none = BitModel::NONE;
        let axis = AxisModels { differs: [none; 2], negative: none, longer: [none; 12], rest: [none; 12] };
        Self {
            place: [none; 18],
            motion: MotionModels { own: [none; 2], axes: [axis; 2] },
            block: [none; 54],
            tile: [none; 162],
            kind: [[none; 2]; 12],
            still: [none; 24],
            steady: [none; 16],
            pixel: [none; PIXELS],
        }
    }
}
