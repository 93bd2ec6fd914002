//! QUIC settings that are the same at both ends.

use std::{sync::Arc, time::Duration};

use quinn::{TransportConfig, VarIntBoundsExceeded};

use crate::congestion::DelayControllerFactory;

/// ALPN of the native client.
pub const ALPN: &[u8] = b"gnomon/1";

/// Round trip assumed before it is measured. quinn resends a lost first packet after three times this.
const INITIAL_RTT: Duration = Duration::from_millis(100);

/// Kernel buffers of a QUIC socket: the client's for a 1920×1080 frame of words, the server's for all its sessions.
pub const SOCKET_BUFFER_BYTES: usize = 8 << 20;

/// Returns the settings that both ends share. Datagram buffers and stream limits are left to the caller.
///
/// # Errors
/// Errors if `idle_timeout` exceeds QUIC's largest integer, in milliseconds.
pub fn transport_config(
    idle_timeout: Duration,
    keep_alive: Duration,
    initial_window_bytes: u64,
) -> Result<TransportConfig, VarIntBoundsExceeded> {
    let mut transport = TransportConfig::default();
    transport
        .max_idle_timeout(Some(idle_timeout.try_into()?))
        .keep_alive_interval(Some(keep_alive))
        .initial_rtt(INITIAL_RTT)
        // Under loss its black-hole detector falls back and drops queued datagrams. Packets fit every path anyway.
        .mtu_discovery_config(None)
        .congestion_controller_factory(Arc::new(DelayControllerFactory { initial_window_bytes }));
    Ok(transport)
}
