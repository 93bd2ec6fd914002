//! One layer of values: the file's or the environment's.

use std::ffi::OsString;

use clap::{ArgMatches, Command};

use crate::error::SettingsError;

/// A setting's value in one layer.
pub(crate) struct Value {
    pub(crate) id: String,
    pub(crate) text: OsString,
    /// A variable's name, or a file, line and key.
    pub(crate) place: String,
}

pub(crate) fn find<'a>(layer: &'a [Value], id: &str) -> Option<&'a Value> {
    layer.iter().find(|value| value.id == id)
}

/// Makes the layer's values the defaults of their arguments.
pub(crate) fn apply(command: Command, layer: &[Value]) -> Command {
    layer.iter().fold(command, |command, value| {
        let text = value.text.clone();
        command.mut_arg(&value.id, |arg| arg.default_value(text))
    })
}

/// Parses one layer without flags, so that an error names its place there.
pub(crate) fn parse_alone(command: &Command, layer: &[Value]) -> Result<ArgMatches, SettingsError> {
    apply(command.clone(), layer).try_get_matches_from([command.get_name()]).map_err(|error| {
        SettingsError::of_layer(error, |named, text| {
            // clap names an argument as its help does, which only a built command knows.
            let mut built = command.clone();
            built.build();
            let arg = built.get_arguments().find(|arg| arg.to_string() == named)?;
            let place = &find(layer, arg.get_id().as_str())?.place;
            // As the shell and as TOML write it.
            let equals = if place.contains(' ') { " = " } else { "=" };
            Some(format!("{place}{equals}{text}"))
        })
    })
}

/// Asks about the known name that is closest to a misspelt one.
pub(crate) fn or_nearest(name: &str, known: &[String]) -> String {
    let nearest = known.iter().min_by_key(|known| strsim::damerau_levenshtein(name, known));
    nearest.map_or_else(String::new, |nearest| format!("; did you mean {nearest}?"))
}
