//! Codecs to compare with: the dissertation's words and bit planes, raw or LZ4. Each slice covers whole rows of tiles.

mod lz4;
mod planes;
mod rows;
mod words;

pub(super) use self::rows::{Form, Writer, check_length, read};
