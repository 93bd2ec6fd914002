//! A `.glb`'s chunks, the targets of URIs, and buffers.

pub(crate) mod buffers;
pub(crate) mod glb;
pub(crate) mod uri;
