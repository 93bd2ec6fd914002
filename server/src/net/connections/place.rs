//! A connection's place among all: held by its owner, and by the transport.

use std::{net::IpAddr, sync::Arc, time::Instant};

use parking_lot::Mutex;
use tokio::sync::Notify;

use super::table::{Stage, Table, Turned};

#[derive(Debug, Clone, Default)]
pub(crate) struct Connections(Arc<Mutex<Table<Arc<Notify>>>>);

/// The owner's half. Dropping it begins the connection's end.
#[derive(Debug)]
pub(crate) struct Place {
    connections: Connections,
    number: u64,
    evicted: Arc<Notify>,
}

/// The transport's half. Dropping it ends the connection.
#[derive(Debug)]
pub(crate) struct Tenure {
    connections: Connections,
    number: u64,
}

impl Connections {
    /// Returns a newcomer's place, which may be another's that has to go. Errors if there is none for it.
    pub(crate) fn arrive(&self, peer: IpAddr) -> Result<(Place, Tenure), Turned> {
        let evicted = Arc::new(Notify::new());
        let (number, other) = self.0.lock().arrive(peer, Arc::clone(&evicted), Instant::now())?;
        if let Some(other) = other {
            other.notify_one();
        }
        let tenure = Tenure { connections: self.clone(), number };
        Ok((Place { connections: self.clone(), number, evicted }, tenure))
    }

    /// Numbers of open connections, by [`Stage`].
    pub(crate) fn counts(&self) -> [usize; Stage::LABELS.len()] {
        self.0.lock().counts()
    }

    pub(crate) fn handshakes(&self) -> usize {
        self.counts()[Stage::Handshake as usize]
    }
}

impl Place {
    /// Waits until another peer takes this place.
    pub(crate) async fn evicted(&self) {
        self.evicted.notified().await;
    }

    pub(super) fn set(&self, stage: Stage) {
        self.connections.0.lock().set(self.number, stage);
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        self.set(Stage::Closing);
    }
}

impl Drop for Tenure {
    fn drop(&mut self) {
        self.connections.0.lock().leave(self.number);
    }
}
