//! Logs: one line an event on standard error, for people or for machines. Standard output belongs to the URL.

use std::io;

use tracing_subscriber::{EnvFilter, fmt, layer::SubscriberExt as _, util::SubscriberInitExt as _};

use crate::config::LogFormat;

/// What is logged unless `RUST_LOG` says otherwise: the libraries' own chatter only from warnings on.
const DEFAULT_FILTER: &str = "warn,gnomon_server=info,gnomon_shaders=info";

/// Starts logging for the whole process.
///
/// # Errors
/// When `RUST_LOG` is malformed, or logging has been started already.
pub fn init(format: LogFormat) -> Result<(), Box<dyn std::error::Error + Send + Sync>> {
    let filter = match std::env::var("RUST_LOG") {
        Ok(directives) if !directives.is_empty() => EnvFilter::try_new(directives)?,
        _ => EnvFilter::try_new(DEFAULT_FILTER)?,
    };
    let registry = tracing_subscriber::registry().with(filter);
    match format {
        LogFormat::Json => registry.with(fmt::layer().json().with_writer(io::stderr)).try_init()?,
        LogFormat::Pretty => {
            let colour = io::IsTerminal::is_terminal(&io::stderr());
            registry.with(fmt::layer().with_ansi(colour).with_writer(io::stderr)).try_init()?;
        }
    }
    Ok(())
}
