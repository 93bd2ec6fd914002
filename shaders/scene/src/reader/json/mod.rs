//! Parses the JSON into the reader's model: `gltf::json`, and the numbers that it would round.

mod document;
mod numbers;
mod schema;
mod value;

pub(crate) use document::{Document, TEXCOORDS, attribute, parse, source};
pub(crate) use numbers::{Factors, Light, TextureTransform, Transform};
