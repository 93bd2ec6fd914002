//! Logs: one line per event, as text or JSON, on standard error or in a file. Standard output carries only the URL.

pub(crate) mod escape;
mod file;
mod init;
mod panics;
pub(crate) mod sink;
pub(crate) mod site_limit;

pub use self::{init::init, panics::log_panics, sink::Logs};
