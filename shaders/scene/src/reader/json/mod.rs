//! The JSON of a file as bounded lists.

pub(crate) mod document;
mod parse;
