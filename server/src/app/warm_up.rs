//! Traces one small mask before clients are admitted, so that none waits for kernels to compile.

use std::time::{Duration, Instant};

use gnomon_protocol::{ids::FrameNumber, mask::MaskShape};
use gnomon_scene::{SceneAt, camera::Camera};

use crate::visibility::{TraceRequest, engine::Engine};

const TIMEOUT: Duration = Duration::from_secs(120);

const SIDE_PX: u16 = 64;

/// Errors if no mask arrives in time.
pub(super) async fn warm_up(engine: &Engine, lights: u32) -> Result<(), String> {
    let shape = MaskShape::new(SIDE_PX.into(), SIDE_PX.into(), lights).map_err(|error| error.to_string())?;
    let mut port = engine.open_session(shape).map_err(|error| error.to_string())?;
    let started_at = Instant::now();
    let camera = Camera::of_pose([0.0; 3], [0.0, 0.0, 0.0, 1.0], 1.0, [SIDE_PX; 2]);
    port.request(TraceRequest {
        frame: FrameNumber(0),
        camera,
        scene: SceneAt::default(),
        ahead: None,
        received_at: started_at,
        interval: Duration::from_secs(1),
    });
    match tokio::time::timeout(TIMEOUT, port.masks.recv()).await {
        Ok(Some(_)) => {
            tracing::info!(ms = started_at.elapsed().as_secs_f64() * 1e3, "warm");
            Ok(())
        }
        Ok(None) => Err("the engine stopped before its first mask".to_owned()),
        Err(_) => Err(format!("no mask in {} s", TIMEOUT.as_secs())),
    }
}
