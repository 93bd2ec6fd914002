use std::{
    ops::AddAssign,
    sync::{Arc, Mutex, PoisonError},
};

use super::impairment::Counts;

/// Totals over all clients.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize)]
pub struct LinkCounts {
    pub up: Counts,
    pub down: Counts,
    /// Datagrams and connections of clients beyond the limit.
    pub refused: u64,
}

impl AddAssign for LinkCounts {
    fn add_assign(&mut self, other: Self) {
        self.up += other.up;
        self.down += other.down;
        self.refused += other.refused;
    }
}

#[derive(Debug, Clone, Default)]
pub(super) struct Shared(Arc<Mutex<LinkCounts>>);

impl Shared {
    pub(super) fn add(&self, counts: LinkCounts) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) += counts;
    }

    pub(super) fn get(&self) -> LinkCounts {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
