//! Parses the JSON into the reader's model: `gltf::json`, and what it would round or does not know.

mod document;
mod material;
mod numbers;
mod schema;
mod value;

pub(crate) use document::{Document, JOINTS, TEXCOORDS, attribute, parse, source};
pub(crate) use material::{Material, SpecularGlossiness, TextureInfo, TextureTransform};
pub(crate) use numbers::{Animation, AnimationSampler, ChannelTarget, Light, Target, Transform};
