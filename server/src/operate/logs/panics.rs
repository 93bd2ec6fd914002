//! Logs panics as one-line events.

use std::{cell::Cell, panic::PanicHookInfo, thread};

thread_local! {
    /// Set while this thread logs a panic, so that a panic within the logger does not recurse.
    static LOGGING: Cell<bool> = const { Cell::new(false) };
}

/// Replaces the panic hook: logs panics instead of printing them. Call [`super::init()`] first.
pub fn log_panics() {
    std::panic::set_hook(Box::new(|panic| {
        if !LOGGING.replace(true) {
            log(panic);
            LOGGING.set(false);
        }
    }));
}

fn log(panic: &PanicHookInfo<'_>) {
    let reason = panic.payload_as_str().unwrap_or("no text").split_whitespace().collect::<Vec<_>>().join(" ");
    let place = panic.location().map(ToString::to_string).unwrap_or_default();
    let thread = thread::current();
    tracing::error!(reason, place, thread = thread.name().unwrap_or_default(), "panicked");
}
