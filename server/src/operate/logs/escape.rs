//! Shows characters that have no picture of their own, so that no text can forge a line or steer a terminal.
//!
//! Fields are escaped as they are formatted. Whole lines are escaped once more as they are written, with what the
//! formats themselves add, such as JSON's quotes, left as it is.

use std::fmt::{self, Debug, Write as _};

use tracing_subscriber::{
    field::RecordFields,
    fmt::{FormatFields, format},
};

/// True for the standard library's list: controls, separators of lines, formats (bidi and zero-width), combining marks,
/// private and unassigned characters.
fn is_hidden(character: char) -> bool {
    !matches!(character, '\'' | '"' | '\\') && character.escape_debug().len() != 1
}

/// How a line is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Form {
    Text,
    /// Text with the escape sequences that choose a colour.
    Coloured,
    Json,
}

/// Returns `line` with its hidden characters escaped, except the line feed at its end.
pub(crate) fn line(line: &str, form: Form) -> String {
    match line.strip_suffix('\n') {
        Some(body) => escaped(body, form) + "\n",
        None => escaped(line, form),
    }
}

/// Returns `text` with its hidden characters escaped.
pub(crate) fn escaped(text: &str, form: Form) -> String {
    let mut shown = String::with_capacity(text.len() + 1);
    let mut rest = text;
    while let Some(at) = rest.find(is_hidden) {
        shown.push_str(&rest[..at]);
        rest = &rest[at..];
        let colour = if form == Form::Coloured { colour_bytes(rest) } else { 0 };
        if colour > 0 {
            shown.push_str(&rest[..colour]);
            rest = &rest[colour..];
        } else if let Some(character) = rest.chars().next() {
            push_escaped(&mut shown, character, form);
            rest = &rest[character.len_utf8()..];
        }
    }
    shown.push_str(rest);
    shown
}

fn push_escaped(shown: &mut String, character: char, form: Form) {
    if form == Form::Json {
        for unit in character.encode_utf16(&mut [0; 2]) {
            // Writing to a string cannot fail.
            let _ = write!(shown, "\\u{unit:04x}");
        }
    } else {
        shown.extend(character.escape_debug());
    }
}

/// Length of the colour sequence (`ESC [ … m`) that `text` begins with, or 0.
fn colour_bytes(text: &str) -> usize {
    let Some(parameters) = text.strip_prefix("\u{1b}[") else { return 0 };
    let digits = parameters.bytes().take_while(|byte| byte.is_ascii_digit() || *byte == b';').count();
    if parameters.as_bytes().get(digits) == Some(&b'm') { 2 + digits + 1 } else { 0 }
}

/// Formats fields as `name=value`, and the message without its name, with hidden characters escaped.
#[derive(Debug, Clone, Copy)]
pub(super) struct EscapedFields;

impl<'writer> FormatFields<'writer> for EscapedFields {
    fn format_fields<R: RecordFields>(&self, writer: format::Writer<'writer>, fields: R) -> fmt::Result {
        let format = format::debug_fn(|writer: &mut format::Writer<'_>, field, value: &dyn Debug| {
            let shown = escaped(&format!("{value:?}"), Form::Text);
            match (field.name(), writer.has_ansi_escapes()) {
                ("message", _) => writer.write_str(&shown),
                (name, true) => write!(writer, "\u{1b}[3m{name}\u{1b}[0m\u{1b}[2m=\u{1b}[0m{shown}"),
                (name, false) => write!(writer, "{name}={shown}"),
            }
        });
        tracing_subscriber::field::MakeExt::delimited(format, " ").format_fields(writer, fields)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hidden_characters_are_shown_and_others_stay() {
        let readable = "compute on \"NVIDIA\" 5 % \\ it's größer, 東京, 1 → 2 🙂\n";
        for form in [Form::Text, Form::Coloured, Form::Json] {
            assert_eq!(line(readable, form), readable);
        }
        assert_eq!(line("a\u{1b}[2J\r\nb\u{202e}\n", Form::Text), "a\\u{1b}[2J\\r\\nb\\u{202e}\n");
        assert_eq!(line("a\u{7f}\u{9b}\u{2028}\u{e0041}\n", Form::Json), "a\\u007f\\u009b\\u2028\\udb40\\udc41\n");
        let colours = "\u{1b}[2m12:00\u{1b}[0m \u{1b}[1;32mINFO\u{1b}[m\n";
        assert_eq!(line(colours, Form::Coloured), colours);
        assert_eq!(line("\u{1b}[2Jx\u{1b}]0;m\u{7}", Form::Coloured), "\\u{1b}[2Jx\\u{1b}]0;m\\u{7}");
        assert_eq!(line("\u{1b}[31", Form::Coloured), "\\u{1b}[31");
    }
}
