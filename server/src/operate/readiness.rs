//! The server's startup state. It is ready once the scene is loaded and the device has traced a mask of it.

use std::sync::Arc;

use tokio::sync::watch;

#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Stage {
    /// Loading the scene, building hierarchies, or warming up the device.
    Starting,
    Ready,
    Draining,
    /// Tracing has failed for good, with the reason.
    Failed(String),
}

#[derive(Debug, Clone)]
pub(crate) struct Readiness(Arc<watch::Sender<Stage>>);

impl Default for Readiness {
    fn default() -> Self {
        Self(Arc::new(watch::Sender::new(Stage::Starting)))
    }
}

impl Readiness {
    pub(crate) fn set(&self, stage: Stage) {
        self.0.send_replace(stage);
    }

    pub(crate) fn get(&self) -> Stage {
        self.0.borrow().clone()
    }
}
