//! Codes eight pixels of a row from the edges of the row above.
//!
//! Silhouettes continue from row to row. So a row below one or two edges is coded as one symbol an edge: how far it
//! moved. An edge's context is how it moved before and where the previous light has one. Where nothing around changes,
//! one bit says so. Only other rows, and those below three or more edges, are coded pixel by pixel, in JBIG2's 10-pixel
//! template (ITU-T T.88, §6.2.5.3) and by where the previous light changes: silhouettes are alike for all lights.

use super::{
    bit_model::{QUICK, SLOW},
    contexts::{ASTRAY, Contexts, FAR, FLAT, MANY, MET, PAIR, SINGLE, STILL, STIR, TURN},
    models::Models,
    neighbours::{BEYOND, RowPart},
    range::BinaryCoder,
};

/// The symbol of a row whose edges are not those of the row above, moved.
const IRREGULAR: usize = 7;

/// Symbol of an edge that moved by −8 to 8 pixels to the right. Symbols 5 and 6 mean three or more.
const SYMBOLS: [u8; 17] = [6, 6, 6, 6, 6, 6, 4, 2, 0, 1, 3, 5, 5, 5, 5, 5, 5];

/// Smallest move that a symbol means, in pixels to the right.
const MOVES: [i32; 8] = [0, 1, -1, 2, -2, 3, -3, 0];

/// Where a window of eight pixels changes from 0 to 1, relative to its middle: 0 is 3 pixels to the right, 6 is 3 to
/// the left, 7 is nowhere. The change nearest to the middle counts.
static SLOPES: [u8; 256] = slopes();

const fn slopes() -> [u8; 256] {
    let mut slopes = [7; 256];
    let mut window: usize = 0;
    while window < slopes.len() {
        // From far to near: the last one found wins.
        let order = [6, 0, 5, 1, 4, 2, 3];
        let mut next = 0;
        while next < order.len() {
            let change = 7 - order[next] as usize;
            if window >> (change - 1) & 3 == 2 {
                slopes[window] = order[next];
            }
            next += 1;
        }
        window += 1;
    }
    slopes
}

/// The same in six pixels: 0 is to the right, 1 in the middle, 2 to the left, 3 nowhere.
static BENDS: [u8; 64] = {
    let mut bends = [3; 64];
    let mut window: usize = 0;
    while window < bends.len() {
        let order: [(u32, u8); 5] = [(5, 0), (1, 2), (4, 0), (2, 2), (3, 1)];
        let mut next = 0;
        while next < order.len() {
            let (change, bend) = order[next];
            if window >> (change - 1) & 3 == 2 {
                bends[window] = bend;
            }
            next += 1;
        }
        window += 1;
    }
    bends
};

/// Which of five pairs of neighbours differs, from 0 on the left to 4; 5 if none does. The one nearest to the middle
/// counts.
const BESIDE: [u8; 32] = {
    let mut beside = [5; 32];
    let mut pairs: usize = 0;
    while pairs < beside.len() {
        let order = [(0, 0), (4, 4), (1, 1), (3, 3), (2, 2)];
        let mut next = 0;
        while next < order.len() {
            if pairs >> order[next].0 & 1 == 1 {
                beside[pairs] = order[next].1;
            }
            next += 1;
        }
        pairs += 1;
    }
    beside
};

/// The value of [`Row::beside`] without a previous light.
const ALONE: usize = 6;

/// [`BESIDE`] in four classes: 0 is the middle, 1 left of it, 2 right of it, 3 elsewhere.
const BESIDE_PAIR: [u8; 7] = [3, 1, 0, 2, 3, 3, 3];

/// Codes eight pixels. Returns the coded pixels; what a decoder passes in is ignored.
#[inline(always)]
pub(super) fn code<B: BinaryCoder>(
    bits: &mut B,
    registers: &mut B::Registers,
    models: &mut Models,
    part: &RowPart<'_>,
    truth: u32,
) -> u32 {
    let (above, second) = (part.above(1), part.above(2));
    let (twelve, ten) = (above >> (BEYOND - 2) & 0xFFF, above >> (BEYOND - 1) & 0x3FF);
    let over = second >> (BEYOND - 1) & 0x3FF;
    let mut row = Row { bits, registers, models, part, truth, twelve, over };
    let around = twelve | over << 12 | part.before << 22;
    if matches!(around, 0 | 0xFF_FFFF) {
        return row.flat(around & 0xFF);
    }
    let changes = (ten ^ ten >> 1) & 0x1FF;
    let more = changes & changes.wrapping_sub(1);
    if changes == 0 {
        row.still(ten)
    } else if more == 0 {
        row.single(changes.trailing_zeros(), (ten & 1).wrapping_neg())
    } else if more & (more - 1) == 0 {
        row.pair([changes.trailing_zeros(), more.trailing_zeros()], (ten & 1).wrapping_neg())
    } else {
        row.pixels::<true>(MANY, None)
    }
}

/// A row that is being coded.
struct Row<'a, 'p, B: BinaryCoder> {
    bits: &'a mut B,
    registers: &'a mut B::Registers,
    models: &'a mut Models,
    part: &'a RowPart<'p>,
    truth: u32,
    /// The row above, starting two pixels to the left; `over` is the row above that, starting one to the left.
    twelve: u32,
    over: u32,
}

impl<B: BinaryCoder> Row<'_, '_, B> {
    #[inline(always)]
    fn bit(&mut self, context: usize, bit: bool) -> bool {
        self.bits.bit_in::<QUICK>(self.registers, &mut self.models.bits[context], bit)
    }

    #[inline(always)]
    fn symbol(&mut self, context: usize, symbol: usize) -> usize {
        self.bits.symbol_in(self.registers, self.models.symbols.at(context), symbol)
    }

    /// Codes pixels around which nothing changes.
    #[inline(always)]
    fn flat(&mut self, value: u32) -> u32 {
        let context = FLAT.at(self.part.surroundings() << 1 | usize::from(value != 0));
        if self.bit(context, self.truth == value) { value } else { self.pixels::<false>(TURN, Some(value)) }
    }

    /// Codes pixels below a row that does not change, when something else around does.
    #[inline(always)]
    fn still(&mut self, ten: u32) -> u32 {
        let lit = (ten & 1).wrapping_neg();
        let over = match (self.over ^ lit) & 0x3FF {
            0 => 0,
            over if over & 0xF != 0 && over & 0x3C0 != 0 => 3,
            over => 1 + usize::from(over & 0x1F == 0),
        };
        let [_, changes] = self.part.changes();
        let other = match self.part.other() {
            None => 4,
            Some(row) => usize::from(matches!(row >> BEYOND & 0xFF, 0 | 0xFF)) | usize::from(changes != 0) << 1,
        };
        let ends = self.twelve ^ lit;
        let ends = (ends & 1 | ends >> 10 & 2) as usize;
        let before = ((self.part.before ^ lit) & 3) as usize;
        let context = (((before * 4 + over) * 4 + ends) * 5 + other) * 2 + usize::from(self.part.is_last());
        let value = lit & 0xFF;
        if self.bit(STILL.at(context), self.truth == value) { value } else { self.pixels::<true>(STIR, Some(value)) }
    }

    /// Returns where the previous light changes near an edge.
    #[inline(always)]
    fn beside(&self, edge: u32) -> usize {
        self.part.other().map_or(ALONE, |row| usize::from(BESIDE[((row ^ row >> 1) >> (edge + 5) & 0x1F) as usize]))
    }

    /// Codes pixels below one edge, left of pixel `edge`. The edge goes from 1 to 0 if all bits of `flip` are set, else
    /// from 0 to 1.
    #[inline(always)]
    fn single(&mut self, edge: u32, flip: u32) -> u32 {
        let [second, third] = [2, 3].map(|nth| self.part.above(nth) ^ flip);
        let slope = u32::from(SLOPES[(second >> (edge + 4) & 0xFF) as usize]);
        let bend = if slope < 7 { BENDS[(third >> (edge + 8 - slope) & 0x3F) as usize] } else { 3 };
        let lags = (self.part.before >> 1 ^ flip) as usize & 1;
        let context = ((slope as usize * 4 + usize::from(bend)) * 2 + lags) * 7 + self.beside(edge);
        let own = (self.truth ^ flip) & 0xFF;
        let moved = (own | 0x100).trailing_zeros();
        let regular = own == 0xFF << moved & 0xFF;
        match self.edge(SINGLE.at(context * 3 + at_end(edge)), regular, edge, moved, [0, 8]) {
            Some(moved) => (0xFF << moved ^ flip) & 0xFF,
            None => self.pixels::<true>(ASTRAY, Some((0xFF << edge ^ flip) & 0xFF)),
        }
    }

    /// Codes pixels below two edges.
    #[inline(always)]
    fn pair(&mut self, edges: [u32; 2], flip: u32) -> u32 {
        let own = (self.truth ^ flip) & 0xFF;
        let from = (own | 0x100).trailing_zeros();
        let to = from + (!(own >> from)).trailing_zeros();
        let regular = own != 0 && own >> to == 0;
        let lags = (self.part.before >> 1 ^ flip) as usize & 1;
        let context = self.pair_context(edges[0], flip, lags);
        let Some(from) = self.edge(context, regular, edges[0], from, [0, 7]) else {
            let flat = flip & 0xFF;
            return if self.bit(MET.at(lags), self.truth == flat) {
                flat
            } else {
                self.pixels::<true>(ASTRAY, Some(flat))
            };
        };
        let before = from.cast_signed() - edges[0].cast_signed();
        let context = self.pair_context(edges[1], !flip, (before.clamp(-2, 2) + 4).cast_unsigned() as usize);
        let to = self.edge(context, true, edges[1], to, [from + 1, 8]).unwrap_or(8);
        ((0xFF << from & !(0xFF << to)) ^ flip) & 0xFF
    }

    /// `before`: the pixel to the left differs from the one above it (0 or 1), or how the edge before moved.
    #[inline(always)]
    fn pair_context(&self, edge: u32, flip: u32, before: usize) -> usize {
        let [above, second] = [1, 2].map(|nth| self.part.above(nth) ^ flip);
        let around = above >> (edge + 6) & 1 | (above >> (edge + 9) & 1) << 1 | (second >> (edge + 6) & 0xF) << 2;
        let beside = usize::from(BESIDE_PAIR[self.beside(edge)]);
        PAIR.at(((around as usize * 4 + beside) * 3 + at_end(edge)) * 7 + before)
    }

    /// Codes an edge's new position, which a decoder keeps within `limits`. Returns `None` if the row is irregular.
    #[inline(always)]
    fn edge(&mut self, context: usize, regular: bool, edge: u32, moved: u32, limits: [u32; 2]) -> Option<u32> {
        let by = moved.cast_signed() - edge.cast_signed();
        let symbol = if regular { SYMBOLS[(by + 8).cast_unsigned() as usize % 17].into() } else { IRREGULAR };
        let symbol = self.symbol(context, symbol);
        if symbol == IRREGULAR {
            return None;
        }
        let mut now = edge.cast_signed() + MOVES[symbol % 8];
        if symbol >= 5 {
            let (step, limit, context) = if symbol == 5 {
                (1, limits[1].cast_signed(), FAR.at(0))
            } else {
                (-1, limits[0].cast_signed(), FAR.at(8))
            };
            let mut steps = 0;
            while steps < 5 && now != limit && self.bit(context + steps, moved.cast_signed() != now) {
                now += step;
                steps += 1;
            }
        }
        Some(now.clamp(0, 8).cast_unsigned())
    }

    /// Codes pixel by pixel. The pixels are known to differ from `expected`.
    #[inline(always)]
    fn pixels<const OTHER: bool>(&mut self, contexts: Contexts, expected: Option<u32>) -> u32 {
        let [across, down] = if OTHER { self.part.changes() } else { [0; 2] };
        // A shift brings the known parts of each pixel's context to the bottom of each piece.
        let pieces = u64::from(self.twelve | self.over << 16) | u64::from(across) << 32 | u64::from(down) << 48;
        let (mut coded, mut before, mut registers) = (0, self.part.before, *self.registers);
        // 0 while the pixels are as expected.
        let mut differs = 0;
        for x in 0..8 {
            let piece = pieces >> x & 0x0001_0001_0007_001F;
            #[expect(clippy::cast_possible_truncation, reason = "only the lowest bits are used")]
            let known = (piece | piece >> 11 | piece >> 22 | piece >> 37) as u32 & 0xCFF;
            let context = known | before << 8 | if OTHER { differs << 12 } else { 0 };
            let bit = match expected {
                Some(expected) if x == 7 && differs == 0 => !expected >> 7 & 1,
                _ => {
                    let model = &mut self.models.bits[contexts.at(context as usize)];
                    u32::from(self.bits.bit_in::<SLOW>(&mut registers, model, self.truth >> x & 1 == 1))
                }
            };
            if let Some(expected) = expected {
                differs |= (expected >> x ^ bit) & 1;
            }
            coded |= bit << x;
            before = before >> 1 | bit << 1;
        }
        *self.registers = registers;
        coded
    }
}

/// Returns 1 for an edge at the first end of the eight pixels, 2 at the last, 0 between.
const fn at_end(edge: u32) -> usize {
    match edge {
        0 => 1,
        8 => 2,
        _ => 0,
    }
}
