//! The contexts of `tiles-small`: their number and first index in the models, for each kind of bit or symbol.

/// Consecutive contexts of one kind.
#[derive(Debug, Clone, Copy)]
pub(super) struct Contexts {
    first: usize,
    count: usize,
}

impl Contexts {
    const fn first(count: usize) -> Self {
        Self { first: 0, count }
    }

    const fn then(self, count: usize) -> Self {
        Self { first: self.end(), count }
    }

    const fn end(self) -> usize {
        self.first + self.count
    }

    /// Returns the model index of context `index`, which must be below the count.
    #[inline(always)]
    pub(super) const fn at(self, index: usize) -> usize {
        self.first + index
    }
}

// Bits, in the order of `prior.bin`.

/// A block has one value. By its surroundings.
pub(super) const BLOCK: Contexts = Contexts::first(32);
/// A tile is mixed; a tile is lit. By the tiles around it.
pub(super) const TILE: Contexts = BLOCK.then(2 * 384);
/// Eight pixels are as predicted, when nothing around them changes.
pub(super) const FLAT: Contexts = TILE.then(128);
/// Eight pixels do not change, below a row that does not change.
pub(super) const STILL: Contexts = FLAT.then(640);
/// An edge that has moved three pixels or more moves one more: to the right, to the left.
pub(super) const FAR: Contexts = STILL.then(2 * 8);
/// Two edges meet.
pub(super) const MET: Contexts = FAR.then(2);
/// A pixel of a row predicted as flat: JBIG2's 10-pixel template.
pub(super) const TURN: Contexts = MET.then(1 << 10);
/// A pixel below three or more edges: the template, and where the previous light changes.
pub(super) const MANY: Contexts = TURN.then(1 << 12);
/// A pixel of a row predicted as unchanged: the same, and whether an earlier pixel differed from the prediction.
pub(super) const STIR: Contexts = MANY.then(1 << 13);
/// A pixel of a row predicted to keep the edges of the row above: the same.
pub(super) const ASTRAY: Contexts = STIR.then(1 << 13);
pub(super) const BIT_CONTEXTS: usize = ASTRAY.end();

// Symbols, in the order of `prior.bin`.

/// How far a single edge moved, by its slope, its bend, the pixel to the left, the previous light and its position.
pub(super) const SINGLE: Contexts = Contexts::first(8 * 4 * 2 * 7 * 3);
/// How far each of two edges moved, by the pixels around it, the previous light, its position and the edge before.
pub(super) const PAIR: Contexts = SINGLE.then(64 * 4 * 3 * 7);
pub(super) const SYMBOL_CONTEXTS: usize = PAIR.end();
