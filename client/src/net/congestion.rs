//! quinn's view of our congestion controller. The client sends little, but by the same rules as the server.

use std::{any::Any, sync::Arc, time::Instant};

use gnomon_protocol::congestion::DelayController;
use quinn::congestion::{Controller, ControllerFactory, ControllerMetrics};
use quinn_proto::RttEstimator;

/// Bytes in flight at the start: some hundred poses.
const INITIAL_WINDOW_BYTES: u64 = 64 * 1024;

/// Makes a controller for each connection.
#[derive(Debug)]
pub(crate) struct DelayControllerFactory;

#[derive(Debug, Clone)]
struct Adapter(DelayController);

impl ControllerFactory for DelayControllerFactory {
    fn build(self: Arc<Self>, _now: Instant, current_mtu: u16) -> Box<dyn Controller> {
        Box::new(Adapter(DelayController::new(INITIAL_WINDOW_BYTES, current_mtu)))
    }
}

impl Controller for Adapter {
    fn on_ack(&mut self, now: Instant, sent: Instant, bytes: u64, app_limited: bool, _rtt: &RttEstimator) {
        // The packet's own round trip: the smoothed one takes jitter for a standing queue.
        self.0.on_ack(now, bytes, app_limited, now.saturating_duration_since(sent));
    }

    fn on_congestion_event(&mut self, now: Instant, _sent: Instant, persistent: bool, lost_bytes: u64) {
        self.0.on_loss(now, lost_bytes, persistent);
    }

    fn on_mtu_update(&mut self, new_mtu: u16) {
        self.0.on_datagram_bytes(new_mtu);
    }

    fn window(&self) -> u64 {
        self.0.window_bytes()
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
        self.0.initial_window_bytes()
    }

    fn into_any(self: Box<Self>) -> Box<dyn Any> {
        self
    }
}
