//! Sets up logging for the process.
//!
//! The JSON lines follow `deploy/logs.schema.json`; `tests/tests/telemetry.rs` checks a real server against it.

use std::{io, path::Path};

use tracing_subscriber::{EnvFilter, fmt, layer::SubscriberExt as _, util::SubscriberInitExt as _};

use super::sink::Logs;
use crate::config::LogFormat;

/// Used without `RUST_LOG`: libraries log warnings and errors only.
const DEFAULT_FILTER: &str = "warn,gnomon_server=info,gnomon_shaders=info";

/// Logs to `file`, or to standard error, until the returned value is dropped.
///
/// # Errors
/// If `RUST_LOG` is malformed, the file cannot be opened, or logging was started before.
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
