//! How a session's masks are coded.

use gnomon_protocol::codec::CodecId;

#[derive(Debug, Clone, Copy)]
pub(crate) struct Coding {
    pub(crate) codec: CodecId,
    /// Wrong bits allowed per million.
    pub(crate) wrong_ppm: u16,
}
