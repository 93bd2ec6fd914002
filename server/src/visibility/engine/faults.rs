//! Faults on demand, for tests and `lab chaos`. Compiled only in tests and with the feature `faults`.

use std::sync::atomic::{AtomicU32, Ordering};

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fault {
    /// The work on the next mask panics.
    Panic,
    DeviceLost,
    /// The device completes nothing any more, and is given up after a tenth of a second.
    NoAnswer,
    /// A call into the driver returns after two seconds only.
    StuckCall,
}

/// Injected faults of one engine, until they happen.
#[derive(Debug, Default)]
pub(super) struct Faults {
    panics: AtomicU32,
    losses: AtomicU32,
    silences: AtomicU32,
    stuck_calls: AtomicU32,
}

impl Faults {
    pub(super) fn add(&self, fault: Fault) {
        self.of(fault).fetch_add(1, Ordering::AcqRel);
    }

    /// Removes one fault of this kind. Returns whether there was one.
    pub(super) fn take(&self, fault: Fault) -> bool {
        let less = |count: u32| count.checked_sub(1);
        self.of(fault).fetch_update(Ordering::AcqRel, Ordering::Acquire, less).is_ok()
    }

    fn of(&self, fault: Fault) -> &AtomicU32 {
        match fault {
            Fault::Panic => &self.panics,
            Fault::DeviceLost => &self.losses,
            Fault::NoAnswer => &self.silences,
            Fault::StuckCall => &self.stuck_calls,
        }
    }
}
