//! Panics go to the log like everything else that an operator reads: one line, whatever was in the message.

use std::{cell::Cell, panic::PanicHookInfo, thread};

thread_local! {
    /// Whether this thread is writing about a panic: one inside the logger's own code must not begin anew.
    static TELLING: Cell<bool> = const { Cell::new(false) };
}

/// From now on a panic of any thread is an event of the log and nothing else. Logging must have been started.
pub fn log_panics() {
    std::panic::set_hook(Box::new(|panic| {
        if !TELLING.replace(true) {
            tell(panic);
            TELLING.set(false);
        }
    }));
}

fn tell(panic: &PanicHookInfo<'_>) {
    let reason = panic.payload_as_str().unwrap_or("no text").split_whitespace().collect::<Vec<_>>().join(" ");
    let place = panic.location().map(ToString::to_string).unwrap_or_default();
    let thread = thread::current();
    tracing::error!(reason, place, thread = thread.name().unwrap_or_default(), "panicked");
}
