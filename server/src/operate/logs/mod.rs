//! Logs: one line per event, as text or JSON, on standard error or in a file. Standard output carries only the URL.

mod init;
mod panics;
pub(crate) mod sink;

pub use self::{init::init, panics::log_panics, sink::Logs};
