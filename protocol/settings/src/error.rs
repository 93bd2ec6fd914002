//! Why settings cannot be used, on one line.

use std::process::ExitCode;

use clap::error::{ContextKind, ContextValue, ErrorKind};
use thiserror::Error;

/// Why a program has no settings to run with.
#[derive(Debug, Error)]
pub enum SettingsError {
    /// The output of `--help` or `--version`.
    #[error("{}", .0.to_string().trim_end())]
    Answer(clap::Error),
    /// An unknown flag, a missing value, or conflicting flags.
    #[error("{0} (see --help)")]
    Usage(String),
    /// A wrong value, key or variable. Names its place.
    #[error("{0}")]
    Value(String),
}

impl SettingsError {
    /// Prints the output or the error. Exit codes: 0 for output, 2 for a wrong command line, 1 for a wrong value.
    #[must_use]
    pub fn report(&self, program: &str) -> ExitCode {
        match self {
            Self::Answer(answer) => {
                // A closed pipe, as with `head`, is no failure.
                let _ = answer.print();
                return ExitCode::SUCCESS;
            }
            Self::Usage(_) | Self::Value(_) => eprintln!("{program}: {self}"),
        }
        ExitCode::from(if matches!(self, Self::Usage(_)) { 2 } else { 1 })
    }

    /// Converts a clap error. `place` says where the named argument's value came from.
    pub(crate) fn of_layer(error: clap::Error, place: impl Fn(&str, &str) -> Option<String>) -> Self {
        let text = |kind| match error.get(kind) {
            Some(ContextValue::String(text)) => text.as_str(),
            _ => "",
        };
        let reason = match (error.kind(), error.get(ContextKind::ValidValue)) {
            (ErrorKind::DisplayHelp | ErrorKind::DisplayVersion, _) => return Self::Answer(error),
            (ErrorKind::ValueValidation, _) => std::error::Error::source(&error).map(ToString::to_string),
            (ErrorKind::InvalidValue, Some(ContextValue::Strings(valid)))
                if !text(ContextKind::InvalidValue).is_empty() =>
            {
                Some(format!("must be one of {}", valid.join(", ")))
            }
            _ => None,
        };
        let place = place(text(ContextKind::InvalidArg), text(ContextKind::InvalidValue));
        match (place, reason) {
            (Some(place), Some(reason)) => Self::Value(one_line(&format!("{place}: {reason}"))),
            (Some(place), None) => Self::Value(format!("{place}: {}", usage(&error))),
            (None, _) => Self::Usage(usage(&error)),
        }
    }
}

/// The first paragraph of clap's message and its tips.
fn usage(error: &clap::Error) -> String {
    let text = error.to_string();
    let (first, rest) = text.split_once("\n\n").unwrap_or((text.as_str(), ""));
    let first = one_line(first.trim_start_matches("error: "));
    let tips = rest.lines().filter_map(|line| line.trim().strip_prefix("tip: "));
    tips.fold(first, |line, tip| format!("{line}; {tip}"))
}

/// Joins the lines of a parser's message.
pub(crate) fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}
