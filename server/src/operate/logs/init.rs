//! Sets up logging for the process.
//!
//! The JSON lines follow `deploy/logs.schema.json`; `tests/tests/telemetry.rs` checks a real server against it.

use std::{io, path::Path};

use tracing::Subscriber;
use tracing_subscriber::{
    EnvFilter, Layer, fmt, layer::SubscriberExt as _, registry::LookupSpan, util::SubscriberInitExt as _,
};

use super::{
    escape::{EscapedFields, Form},
    sink::{Lines, Logs},
    site_limit::SiteLimit,
};
use crate::config::LogFormat;

/// Used without `RUST_LOG`. Libraries log errors only, because peers trigger most of their warnings. quinn-udp warns
/// once a minute at most, of datagrams that cannot be sent.
const DEFAULT_FILTER: &str = "error,gnomon_server=info,gnomon_shaders=info,quinn_udp=warn,web_transport_quinn=off";

/// Logs to `file`, or to standard error, until the returned value is dropped.
///
/// # Errors
/// If `RUST_LOG` is malformed, the file cannot be opened, or logging was started before.
pub fn init(format: LogFormat, file: Option<&Path>) -> Result<Logs, Box<dyn std::error::Error + Send + Sync>> {
    let filter = match std::env::var("RUST_LOG") {
        Ok(directives) if !directives.is_empty() => {
            EnvFilter::try_new(&directives).map_err(|error| format!("RUST_LOG={directives}: {error}"))?
        }
        _ => EnvFilter::try_new(DEFAULT_FILTER)?,
    };
    let form = match format {
        LogFormat::Json => Form::Json,
        LogFormat::Pretty if file.is_none() && gnomon_settings::wants_colour(&io::stderr()) => Form::Coloured,
        LogFormat::Pretty => Form::Text,
    };
    // A process has one log, which lasts as long as the process.
    let limit: &'static SiteLimit = Box::leak(Box::default());
    let (logs, lines) = Logs::open(file, form, limit)?;
    tracing_subscriber::registry().with(filter).with(layer(form, lines, limit)).try_init()?;
    Ok(logs)
}

fn layer<S>(form: Form, lines: Lines, limit: &'static SiteLimit) -> Box<dyn Layer<S> + Send + Sync>
where
    S: Subscriber + for<'a> LookupSpan<'a> + Send + Sync,
{
    let layer = fmt::layer().log_internal_errors(false).with_writer(lines);
    match form {
        Form::Json => layer.json().with_filter(limit).boxed(),
        Form::Text | Form::Coloured => {
            let colour = form == Form::Coloured;
            layer.with_ansi(colour).fmt_fields(EscapedFields).with_filter(limit).boxed()
        }
    }
}

#[cfg(test)]
mod tests {
    use std::io;

    use super::*;

    /// What a peer might write: every character that could be hidden, and what a terminal obeys.
    fn texts() -> Vec<String> {
        let every = (0..=0x2fff).chain(0xe000..=0xf8ff).chain(0xfe00..=0xffff).chain(0xe_0000..=0xe_01ff);
        let every = every.filter_map(char::from_u32).map(|character| format!("a{character}b"));
        let forged =
            ["\n2026-11-29T00:00:00Z  INFO gnomon_server: forged", "\u{1b}[2J\u{1b}[31m", "\u{1b}]0;title\u{7}"];
        every.chain(forged.map(str::to_owned)).collect()
    }

    /// Logs at a level without a limit. Returns the file's lines.
    fn logged(form: Form, texts: &[String]) -> Vec<String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log");
        let limit: &'static SiteLimit = Box::leak(Box::default());
        let (logs, lines) = Logs::open(Some(&path), form, limit).unwrap();
        tracing::subscriber::with_default(tracing_subscriber::registry().with(layer(form, lines, limit)), || {
            for (number, some) in texts.chunks(4000).enumerate() {
                // Waits for the thread, whose queue is bounded.
                while number > 0 && std::fs::read_to_string(&path).unwrap().lines().count() < number * 4000 {
                    std::thread::yield_now();
                }
                for text in some {
                    let error = io::Error::other(text.clone());
                    let span =
                        tracing::debug_span!("peer", shown = %text, quoted = text, later = tracing::field::Empty);
                    span.record("later", tracing::field::display(text));
                    let _entered = span.entered();
                    tracing::debug!(shown = %text, debugged = ?text, quoted = text, %error, "said {text}");
                }
            }
        });
        drop(logs);
        let text = std::fs::read_to_string(&path).unwrap();
        text.strip_suffix('\n').unwrap().split('\n').map(str::to_owned).collect()
    }

    fn without_colours(line: &str) -> String {
        let mut parts = line.split("\u{1b}[");
        let first = parts.next().unwrap_or_default().to_owned();
        parts.fold(first, |line, part| {
            let (colour, rest) = part.split_once('m').unwrap();
            assert!(["0", "1", "2", "3", "34"].contains(&colour), "{colour:?} is no colour of ours");
            line + rest
        })
    }

    #[test]
    fn no_text_forges_a_line_or_steers_a_terminal_in_any_format() {
        let texts = texts();
        for form in [Form::Text, Form::Coloured, Form::Json] {
            let lines = logged(form, &texts);
            assert_eq!(lines.len(), texts.len(), "{form:?}");
            for (line, text) in lines.iter().zip(&texts) {
                let plain = if form == Form::Coloured { without_colours(line) } else { line.clone() };
                let visible = |c: char| matches!(c, '\'' | '"' | '\\') || c.escape_debug().len() == 1;
                assert!(plain.chars().all(visible), "{form:?}: {line:?}");
                if form == Form::Json {
                    let entry: serde_json::Value = serde_json::from_str(line).unwrap();
                    assert_eq!(
                        (&entry["fields"]["shown"], &entry["span"]["quoted"]),
                        (&text[..].into(), &text[..].into())
                    );
                } else {
                    assert!(
                        plain.contains("said ") && plain.contains("peer{shown=") && plain.contains("later="),
                        "{plain}"
                    );
                }
            }
        }
    }
}
