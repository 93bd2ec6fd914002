//! What a page chooses, and what a person changes.

use gnomon_client_core::{
    camera::path::CameraPath,
    frame::mode::Mode,
    predictor::Predictor,
    render::{debug_view::DebugView, quality::Quality, tone::ToneCurve},
};
use gnomon_protocol::limits::MAX_LAYERS;

/// What a page chooses before the scene is there.
#[derive(Debug, Clone, Default)]
pub struct Options {
    /// `None` adapts to what the camera sees.
    pub exposure: Option<f32>,
    /// Where to begin, as a link has it.
    pub view: Option<String>,
    /// Draws these frames of a path, each with its own mask, and then goes on as ever.
    pub walk: Option<Walk>,
}

#[derive(Debug, Clone)]
pub struct Walk {
    pub path: CameraPath,
    pub frames: u32,
}

impl Walk {
    /// The frame's time on the path, in seconds: frames are spread evenly over it, as in a headless run.
    pub(crate) fn time_s(&self, frame: u32) -> f64 {
        let step_s = self.path.duration_s() / f64::from(self.frames.saturating_sub(1).max(1));
        f64::from(frame) * step_s
    }
}

/// Returns the debug view of this name on the page.
#[must_use]
pub fn view_named(name: &str) -> Option<DebugView> {
    match name {
        "picture" => Some(DebugView::Picture),
        "unknown" => Some(DebugView::Unknown),
        "age" => Some(DebugView::Age { lags: [0; MAX_LAYERS] }),
        "depth" => Some(DebugView::Depth),
        "normals" => Some(DebugView::Normals),
        "light" => Some(DebugView::Light(0)),
        _ => None,
    }
}

/// What a person changes while looking.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Settings {
    pub predictor: Predictor,
    pub mode: Mode,
    pub view: DebugView,
    pub tone: ToneCurve,
    pub quality: Quality,
    /// True if the right half is lit without visibility.
    pub split: bool,
}
