use std::{io, net::SocketAddr};

use tokio::task::AbortHandle;

use super::counters::{LinkCounts, Shared};

/// A running relay. Dropping it ends it, with all of its connections.
#[derive(Debug)]
pub struct Relay {
    pub(super) address: SocketAddr,
    pub(super) shared: Shared,
    /// Owns the tasks of all connections.
    pub(super) task: AbortHandle,
}

impl Relay {
    pub const fn address(&self) -> SocketAddr {
        self.address
    }

    pub fn counts(&self) -> LinkCounts {
        self.shared.get()
    }
}

impl Drop for Relay {
    fn drop(&mut self) {
        self.task.abort();
    }
}

/// Errors unless the address is loopback: a link forwards anything, so other machines must not reach it.
pub(super) fn loopback_only(address: SocketAddr) -> io::Result<SocketAddr> {
    if address.ip().is_loopback() {
        return Ok(address);
    }
    Err(io::Error::new(io::ErrorKind::InvalidInput, format!("{address} is not loopback: the link takes nothing else")))
}
