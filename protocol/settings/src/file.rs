//! The TOML file: one flat table, whose keys are settings.

use std::{ffi::OsString, fs::File, io::Read as _, path::Path};

use clap::{Arg, Command};
use toml::de::{DeTable, DeValue};

use crate::{
    declare::{is, is_number},
    error::{SettingsError, one_line},
    layer::{Value, or_nearest},
};

/// Largest file, in bytes.
const MAX_FILE_BYTES: u64 = 256 * 1024;

/// Reads the file's values. Errors name file, line and key.
pub(crate) fn read(path: &Path, command: &Command, keys: &[String]) -> Result<Vec<Value>, SettingsError> {
    let wrong = |reason: String| SettingsError::Value(format!("{}: {reason}", path.display()));
    let mut text = String::new();
    let bytes = File::open(path)
        .and_then(|file| file.take(MAX_FILE_BYTES + 1).read_to_string(&mut text))
        .map_err(|error| SettingsError::Value(format!("cannot read the configuration {}: {error}", path.display())))?;
    if bytes as u64 > MAX_FILE_BYTES {
        return Err(wrong(format!("longer than {MAX_FILE_BYTES} bytes")));
    }
    let mut values = parse(&text, command, keys).map_err(wrong)?;
    for value in &mut values {
        value.place = format!("{}: {}", path.display(), value.place);
    }
    Ok(values)
}

/// Parses the values of a TOML text. Errors are one line that begins with the line's number.
pub(crate) fn parse(text: &str, command: &Command, keys: &[String]) -> Result<Vec<Value>, String> {
    let table = DeTable::parse(text).map_err(|error| {
        let reason = one_line(error.message());
        format!("{}: {reason}", line_of(error.span(), text))
    })?;
    let mut values = Vec::new();
    for (key, value) in table.get_ref() {
        let line = line_of(Some(key.span()), text);
        let id = key.get_ref().as_ref();
        let arg = command.get_arguments().find(|arg| keys.iter().any(|key| key == id) && arg.get_id() == id);
        let Some(arg) = arg else {
            return Err(format!("{line}: unknown key {id:?}{}", or_nearest(id, keys)));
        };
        let text = scalar(arg, value.get_ref()).map_err(|reason| format!("{line}: {id} {reason}"))?;
        values.push(Value { id: id.to_owned(), text, place: format!("{line}: {id}") });
    }
    Ok(values)
}

/// Returns a value as a flag would spell it. Numbers and booleans are not quoted, everything else is.
fn scalar(arg: &Arg, value: &DeValue<'_>) -> Result<OsString, String> {
    let text = match value {
        DeValue::Boolean(value) if is::<bool>(arg) => value.to_string(),
        DeValue::Integer(value) if is_number(arg) => {
            let value = i64::from_str_radix(value.as_str(), value.radix());
            value.map_err(|_| "is too large".to_owned())?.to_string()
        }
        DeValue::Float(value) if is_number(arg) => value.as_str().to_owned(),
        DeValue::String(value) if !is::<bool>(arg) && !is_number(arg) => value.to_string(),
        other => {
            let kind = match () {
                () if is::<bool>(arg) => "true or false",
                () if is_number(arg) => "a number",
                () => "a string",
            };
            return Err(format!("must be {kind}, not {}", other.type_str()));
        }
    };
    Ok(text.into())
}

/// The place of a TOML error, without quoting the text: a token file's errors must not reveal it.
#[must_use]
pub fn line_of(span: Option<std::ops::Range<usize>>, text: &str) -> String {
    match span.and_then(|span| text.get(..span.start)) {
        Some(before) => format!("line {}", before.matches('\n').count() + 1),
        None => "some line".to_owned(),
    }
}
