//! Signals that end the run. The first asks for the end; a second one ends the process at once.

use std::io;

use crate::stop::{Cause, Stop};

/// Makes SIGINT, SIGTERM and SIGHUP ask `stop`; on other systems than Unix, Ctrl-C does.
///
/// # Errors
/// Errors if the system refuses a handler or a thread.
pub fn watch(stop: &Stop) -> io::Result<()> {
    system::watch(stop.clone())
}

#[cfg(not(unix))]
use elsewhere as system;
#[cfg(unix)]
use unix as system;

#[cfg(unix)]
mod unix {
    use std::{
        io,
        sync::{Arc, atomic::AtomicBool},
    };

    use signal_hook::{
        consts::{SIGHUP, SIGINT, SIGTERM},
        flag,
        iterator::Signals,
    };

    use super::{Cause, Stop};

    const CAUSES: [(i32, Cause); 3] =
        [(SIGINT, Cause::Interrupt), (SIGTERM, Cause::Terminate), (SIGHUP, Cause::HangUp)];

    pub(super) fn watch(stop: Stop) -> io::Result<()> {
        let ignored = ignored();
        let watched: Vec<(i32, Cause)> = CAUSES
            .into_iter()
            // `nohup` has clients outlive their terminal.
            .filter(|(signal, _)| *signal != SIGHUP || ignored >> (SIGHUP - 1) & 1 == 0)
            .collect();
        let asked = Arc::new(AtomicBool::new(false));
        for (signal, cause) in &watched {
            // Handlers run in this order, so the first signal finds the flag unset and then sets it.
            flag::register_conditional_shutdown(*signal, cause.exit_code().into(), Arc::clone(&asked))?;
            flag::register(*signal, Arc::clone(&asked))?;
        }
        let mut signals = Signals::new(watched.iter().map(|(signal, _)| signal))?;
        std::thread::Builder::new().name("signals".to_owned()).spawn(move || {
            for signal in signals.forever() {
                if let Some((_, cause)) = watched.iter().find(|(number, _)| *number == signal) {
                    stop.ask(*cause);
                }
            }
        })?;
        Ok(())
    }

    /// Returns the signals that this process was started to ignore, where the system tells: bit 0 is signal 1.
    fn ignored() -> u64 {
        let read = || {
            let status = std::fs::read_to_string("/proc/self/status").ok()?;
            let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"))?;
            u64::from_str_radix(mask.trim(), 16).ok()
        };
        read().unwrap_or(0)
    }
}

#[cfg(not(unix))]
mod elsewhere {
    use std::io;

    use super::{Cause, Stop};

    pub(super) fn watch(stop: Stop) -> io::Result<()> {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        std::thread::Builder::new().name("signals".to_owned()).spawn(move || {
            runtime.block_on(async {
                if tokio::signal::ctrl_c().await.is_ok() {
                    stop.ask(Cause::Interrupt);
                    let _ = tokio::signal::ctrl_c().await;
                    std::process::exit(Cause::Interrupt.exit_code().into());
                }
            });
        })?;
        Ok(())
    }
}
