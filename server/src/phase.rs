//! The phases of the server's shutdown, for its sessions.

use tokio::sync::watch;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Phase {
    Running,
    /// New clients are refused; connected ones are asked to move to another server.
    Draining,
    /// Sessions send the frames in flight, then end.
    Stopping,
}

/// Waits for [`Phase::Stopping`], or for the server to be dropped.
pub(crate) async fn stopping(phase: &mut watch::Receiver<Phase>) {
    drop(phase.wait_for(|phase| *phase == Phase::Stopping).await);
}
