//! Bytes: a `.glb`'s chunks, where URIs lead, and buffers.

pub(crate) mod buffers;
pub(crate) mod glb;
pub(crate) mod uri;
