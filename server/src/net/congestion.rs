//! quinn's view of our congestion controller, `gnomon_protocol::congestion`.

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

/// Makes a controller for each connection.
#[derive(Debug)]
pub(crate) struct DelayControllerConfig {
    /// Bytes in flight that it starts with.
    pub(crate) initial_window_bytes: u64,
}

#[derive(Debug, Clone)]
struct Adapter {
    controller: DelayController,
    held_back: Arc<AtomicBool>,
}

/// Says whether a connection's sender could send more than it does. Frames that are cut down to the window never fill it, so quinn takes
/// their sender for one that has no more to send, and the window would not grow.
pub(crate) fn hold_back(connection: &quinn::Connection, held_back: bool) {
    // What comes is a copy of the controller, which shares this with it.
    if let Ok(adapter) = connection.congestion_state().into_any().downcast::<Adapter>() {
        adapter.held_back.store(held_back, Ordering::Relaxed);
    }
}

impl ControllerFactory for DelayControllerConfig {
    fn build(self: Arc<Self>, _now: Instant, current_mtu: u16) -> Box<dyn Controller> {
        let controller = DelayController::new(self.initial_window_bytes, current_mtu);
        Box::new(Adapter { controller, held_back: Arc::default() })
    }
}

impl Controller for Adapter {
    fn on_ack(&mut self, now: Instant, sent: Instant, bytes: u64, app_limited: bool, _rtt: &RttEstimator) {
        // The packet's own round trip: the smoothed one takes jitter for a standing queue.
        let app_limited = app_limited && !self.held_back.load(Ordering::Relaxed);
        self.controller.on_ack(now, bytes, app_limited, now.saturating_duration_since(sent));
    }

    fn on_congestion_event(&mut self, now: Instant, _sent: Instant, is_persistent_congestion: bool, lost_bytes: u64) {
        self.controller.on_loss(now, lost_bytes, is_persistent_congestion);
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
