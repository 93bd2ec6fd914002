//! A probe's request to a server.

use gnomon_client::{app::probe::ProbeOptions, link::url::ServerUrl};
use gnomon_protocol::codec::CodecId;

#[derive(Debug, Clone, Copy)]
pub struct Ask {
    /// Size of the masks, in pixels.
    pub size: (u32, u32),
    /// Poses a second; without it, each pose waits for the mask of the one before.
    pub fps: Option<f64>,
    pub frames: u32,
}

impl Ask {
    /// Returns a probe without a token, from the beginning of its path.
    pub fn of(self, url: &ServerUrl) -> ProbeOptions {
        ProbeOptions {
            url: url.clone(),
            token: None,
            width: self.size.0,
            height: self.size.1,
            codec: CodecId::PlanesLz4,
            frames: self.frames,
            fps: self.fps,
            connect_timeout: ProbeOptions::CONNECT_TIMEOUT,
            start_time_s: 0.0,
        }
    }
}
