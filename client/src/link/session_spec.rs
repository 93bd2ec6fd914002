//! What defines a session, so that it can be opened again elsewhere.

use std::time::Duration;

use gnomon_protocol::{
    PROTOCOL_VERSION,
    codec::CodecId,
    ids::{BearerToken, ResumeToken, SceneDigest},
    mask::MaskShape,
    message::Hello,
};

use super::{receive_options::Reception, url::ServerUrl};
use crate::stop::Stop;

/// What the client requests in its Hello, and how long it may last.
#[derive(Debug, Clone)]
pub(crate) struct SessionOptions {
    pub(crate) token: Option<BearerToken>,
    /// In pixels.
    pub(crate) width: u32,
    pub(crate) height: u32,
    pub(crate) codec: CodecId,
    /// Largest rate of masks; 0 for no limit.
    pub(crate) rate_hz: u16,
    /// Share of a frame's bits that may be wrong, in parts per million.
    pub(crate) wrong_ppm: u16,
    pub(crate) resume: Option<ResumeToken>,
    pub(crate) connect_timeout: Duration,
    pub(crate) stop: Stop,
}

/// A started session.
#[derive(Debug, Clone)]
pub(crate) struct SessionSpec {
    pub(crate) url: ServerUrl,
    pub(crate) options: SessionOptions,
    pub(crate) scene_digest: SceneDigest,
    pub(crate) shape: MaskShape,
    pub(crate) reception: Reception,
}

impl SessionOptions {
    pub(super) fn hello(&self) -> Hello {
        Hello {
            version: PROTOCOL_VERSION,
            token: self.token.clone(),
            client: concat!("gnomon-client ", env!("CARGO_PKG_VERSION")).into(),
            width: self.width,
            height: self.height,
            codec: self.codec,
            rate_hz: self.rate_hz,
            wrong_ppm: self.wrong_ppm,
            resume: self.resume,
        }
    }
}

/// Returns a frame rate as the Hello has it: whole frames a second, 0 for no limit.
pub(crate) fn rate_hz(fps: Option<f64>) -> u16 {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the range")]
    fps.map_or(0, |fps| fps.ceil().clamp(1.0, f64::from(u16::MAX)) as u16)
}
