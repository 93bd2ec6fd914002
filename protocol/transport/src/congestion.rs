//! quinn's adapter for the congestion controller of `gnomon_protocol`.

use std::{
    any::Any,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Instant,
};

use gnomon_protocol::congestion::DelayController;
use quinn::congestion::{Controller, ControllerFactory, ControllerMetrics};
use quinn_proto::RttEstimator;

/// Builds a [`DelayController`] for each connection.
#[derive(Debug)]
pub struct DelayControllerFactory {
    /// Bytes in flight before the first acknowledgement.
    pub initial_window_bytes: u64,
}

#[derive(Debug, Clone)]
struct Adapter {
    controller: DelayController,
    ignores_app_limit: Arc<AtomicBool>,
}

/// Sets whether the window may grow even if the sender does not fill it.
///
/// Frames cut to the window never fill it. quinn then takes the sender for application-limited, and the window would
/// not grow. Does nothing on a connection with another controller.
pub fn ignore_app_limit(connection: &quinn::Connection, ignore: bool) {
    // quinn returns a copy of the controller, which shares the flag with its original.
    if let Ok(adapter) = connection.congestion_state().into_any().downcast::<Adapter>() {
        adapter.ignores_app_limit.store(ignore, Ordering::Relaxed);
    }
}

impl ControllerFactory for DelayControllerFactory {
    fn build(self: Arc<Self>, _now: Instant, current_mtu: u16) -> Box<dyn Controller> {
        let controller = DelayController::new(self.initial_window_bytes, current_mtu);
        Box::new(Adapter { controller, ignores_app_limit: Arc::default() })
    }
}

impl Controller for Adapter {
    fn on_ack(&mut self, now: Instant, sent: Instant, bytes: u64, app_limited: bool, _rtt: &RttEstimator) {
        let app_limited = app_limited && !self.ignores_app_limit.load(Ordering::Relaxed);
        // The packet's own round trip: the smoothed one takes jitter for a standing queue.
        self.controller.on_ack(now, bytes, app_limited, now.saturating_duration_since(sent));
    }

    fn on_congestion_event(&mut self, now: Instant, _sent: Instant, persistent: bool, lost_bytes: u64) {
        self.controller.on_loss(now, lost_bytes, persistent);
    }

    fn on_mtu_update(&mut self, new_mtu: u16) {
        self.controller.on_datagram_bytes(new_mtu);
    }

    fn window(&self) -> u64 {
        self.controller.window_bytes()
    }

    fn metrics(&self) -> ControllerMetrics {
        let mut metrics = ControllerMetrics::default();
        metrics.congestion_window = self.window();
        metrics
    }

    fn clone_box(&self) -> Box<dyn Controller> {
        Box::new(self.clone())
    }

    fn initial_window(&self) -> u64 {
        self.controller.initial_window_bytes()
    }

    fn into_any(self: Box<Self>) -> Box<dyn Any> {
        self
    }
}
