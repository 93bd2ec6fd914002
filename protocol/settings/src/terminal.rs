//! Whether a program colours what it prints.

use std::io::IsTerminal;

/// Returns whether `stream` is a terminal that shows colours, and `NO_COLOR` (no-color.org) is unset or empty.
#[must_use]
pub fn wants_colour(stream: &impl IsTerminal) -> bool {
    let set = |name| std::env::var_os(name).filter(|value| !value.is_empty());
    stream.is_terminal() && set("NO_COLOR").is_none() && set("TERM").is_none_or(|terminal| terminal != "dumb")
}
