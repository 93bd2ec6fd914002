//! Logs: one line an event, for people or for machines, on standard error or in a file. Standard output belongs to the URL.
//!
//! What the JSON lines hold is a contract: `deploy/logs.schema.json`, against which `tests/tests/telemetry.rs` checks the real server.

use std::{io, path::Path};

use tracing_subscriber::{EnvFilter, fmt, layer::SubscriberExt as _, util::SubscriberInitExt as _};

use super::sink::Logs;
use crate::config::LogFormat;

/// What is logged unless `RUST_LOG` says otherwise: the libraries' own chatter only from warnings on.
const DEFAULT_FILTER: &str = "warn,gnomon_server=info,gnomon_shaders=info";

/// Starts logging for the whole process: into `file`, or on standard error. The lines are written until what it returns is dropped.
///
/// # Errors
/// When `RUST_LOG` is malformed, the file cannot be opened, or logging has been started already.
pub fn init(format: LogFormat, file: Option<&Path>) -> Result<Logs, Box<dyn std::error::Error + Send + Sync>> {
    let filter = match std::env::var("RUST_LOG") {
        Ok(directives) if !directives.is_empty() => EnvFilter::try_new(directives)?,
        _ => EnvFilter::try_new(DEFAULT_FILTER)?,
    };
    let (logs, lines) = Logs::open(file)?;
    let registry = tracing_subscriber::registry().with(filter);
    match format {
        LogFormat::Json => {
            registry.with(fmt::layer().json().log_internal_errors(false).with_writer(lines)).try_init()?;
        }
        LogFormat::Pretty => {
            let colour = file.is_none() && io::IsTerminal::is_terminal(&io::stderr());
            registry.with(fmt::layer().log_internal_errors(false).with_ansi(colour).with_writer(lines)).try_init()?;
        }
    }
    Ok(logs)
}
