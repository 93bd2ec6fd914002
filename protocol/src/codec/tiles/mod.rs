//! Planes in blocks of 8×8 tiles, in slices that each fit one datagram and can be decoded alone.
//!
//! | bytes of a slice | field |
//! |---|---|
//! | 0–2 | its first block, in the order of [`order`] |
//! | 3–4 | its number of blocks, at least one |
//! | to the end | the bits: [`small`]'s model in [`range`]'s coder, or [`fast`]'s symbols in [`codes`] |
//!
//! All little-endian. If the frame's head names a reference, `tiles-small` codes motion and differences ([`inter`]).
//! Slices are independent: contexts end at a slice's first block, and its probabilities begin with [`prior`]. So a lost
//! slice loses nothing else, and ranges of slices are coded on several threads ([`coder_thread`]). Ranges depend on the
//! mask alone: a frame's bytes are the same on any number of cores.

mod bit_model;
mod bits;
mod block;
mod block_range;
mod coder_thread;
mod codes;
mod contexts;
mod edges;
mod fast;
mod inter;
mod mode;
mod models;
mod motion;
mod neighbours;
mod order;
mod partition;
mod prior;
mod range;
mod reference;
mod refine;
mod slice;
mod small;
mod symbol_model;
mod table;
mod training;
mod workspace;

pub(super) use self::{
    mode::{Mode, Profile},
    slice::{Failure, block_count, blocks_of},
    workspace::Workspace,
};
pub use self::{reference::Reference, slice::part_words, training::train};
