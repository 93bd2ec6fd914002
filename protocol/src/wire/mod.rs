//! The formats on the wire, byte by byte.

pub mod acknowledgement;
mod codec_id;
pub mod edit;
pub mod frame;
pub mod header;
pub mod message;

pub use self::codec_id::{CodecId, UnknownCodec};
