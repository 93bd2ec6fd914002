//! Visibility codecs: masks to bytes and back.
//!
//! | codec | raw bytes of a slice | in the frame |
//! |---|---|---|
//! | `words` | a u32 a pixel, row by row (dissertation §3.1) | uncompressed |
//! | `words-lz4` | the same | LZ4 block (dissertation §3.5) |
//! | `planes-lz4` | for each light the slice's 8×8 tiles, a u64 each | LZ4 block |
//! | `tiles-small`, `tiles-fast` | – | [`tiles`], each slice fits a datagram |
//!
//! A slice that LZ4 does not shorten is sent raw. The decoder is strict: a slice yields exactly its raw bytes, and bits
//! without a light or outside the picture must be 0. The encoder writes such bits as 0.
//!
//! All codecs are lossless. A [`Simplifier`] before them trades wrong bits for bytes.
//!
//! Encoder and decoder reuse their memory: after the largest frame they allocate nothing.

mod baseline;
mod decoder;
mod encoded_frame;
mod encoder;
mod error;
mod form;
mod part;
mod simplify;
mod tiles;
mod transpose;

#[doc(hidden)]
pub use self::tiles::train as train_tiles;
pub use self::{
    decoder::Decoder,
    encoded_frame::EncodedFrame,
    encoder::Encoder,
    error::{DecodeError, EncodeError},
    part::Part,
    simplify::Simplifier,
    tiles::{Reference, part_words},
};
pub use crate::{
    ids::ReferenceName,
    wire::{CodecId, UnknownCodec},
};
