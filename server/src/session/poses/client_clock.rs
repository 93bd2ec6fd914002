//! The client's clock: converts milliseconds that wrap at 2³² to seconds that do not.

use std::time::Duration;

#[derive(Debug, Default)]
pub(super) struct ClientClock {
    newest_ms: u64,
}

impl ClientClock {
    pub(super) fn seconds(&mut self, client_time_ms: u32) -> f64 {
        const WRAP_MS: u64 = 1 << 32;
        let base = self.newest_ms - self.newest_ms % WRAP_MS;
        let unwrapped = base + u64::from(client_time_ms);
        // More than half a wrap back means that the clock wrapped. Less means a late pose, or a reset clock.
        let time_ms = if unwrapped + WRAP_MS / 2 < self.newest_ms { unwrapped + WRAP_MS } else { unwrapped };
        self.newest_ms = time_ms;
        Duration::from_millis(time_ms).as_secs_f64()
    }
}
