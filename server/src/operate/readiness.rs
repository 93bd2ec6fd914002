//! Whether clients shall come: only once the scene is loaded and the device has traced a mask of it, and not while the server drains.

use std::{sync::Arc, time::Duration, time::Instant};

use gnomon_protocol::{ids::FrameNumber, mask::MaskShape};
use gnomon_scene::camera::Camera;
use tokio::sync::watch;

use crate::visibility::{TraceRequest, engine::Engine};

/// Longest time that the first mask may take: kernels may still be compiled in it.
const WARM_UP_TIMEOUT: Duration = Duration::from_secs(120);

/// Side of the mask that is traced to find out.
const WARM_UP_PX: u16 = 64;

/// How far the server is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Stage {
    /// It still loads its scene, builds its hierarchy or warms its device up.
    Starting,
    /// Clients may come.
    Ready,
    /// It asks its clients to leave.
    Draining,
    /// It can trace no more, and why.
    Failed(String),
}

/// Where the server says how far it is, and others look.
#[derive(Debug, Clone)]
pub(crate) struct Readiness(Arc<watch::Sender<Stage>>);

impl Default for Readiness {
    fn default() -> Self {
        Self(Arc::new(watch::Sender::new(Stage::Starting)))
    }
}

impl Readiness {
    /// Says how far it is.
    pub(crate) fn set(&self, stage: Stage) {
        self.0.send_replace(stage);
    }

    /// How far it is.
    pub(crate) fn get(&self) -> Stage {
        self.0.borrow().clone()
    }
}

/// Traces a small mask, and waits for it.
///
/// # Errors
/// Says why none came.
pub(crate) async fn warm_up(engine: &Engine, lights: u32) -> Result<(), String> {
    let shape = MaskShape::new(WARM_UP_PX.into(), WARM_UP_PX.into(), lights).map_err(|error| error.to_string())?;
    let mut port = engine.open_session(shape).map_err(|error| error.to_string())?;
    let started_at = Instant::now();
    let camera = Camera::of_pose([0.0; 3], [0.0, 0.0, 0.0, 1.0], 1.0, [WARM_UP_PX; 2]);
    port.request(TraceRequest {
        frame: FrameNumber(0),
        camera,
        ahead: None,
        received_at: started_at,
        interval: Duration::from_secs(1),
    });
    match tokio::time::timeout(WARM_UP_TIMEOUT, port.masks.recv()).await {
        Ok(Some(_)) => {
            tracing::info!(ms = started_at.elapsed().as_secs_f64() * 1e3, "warm");
            Ok(())
        }
        Ok(None) => Err("the engine stopped before its first mask".to_owned()),
        Err(_) => Err(format!("no mask in {} s", WARM_UP_TIMEOUT.as_secs())),
    }
}
