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

/// Parses one layer without flags, so that errors name their place in it.
pub(crate) fn parse_alone(command: &Command, layer: &[Value]) -> Result<ArgMatches, SettingsError> {
    apply(command.clone(), layer).try_get_matches_from([command.get_name()]).map_err(|error| {
        SettingsError::of_layer(error, |named, text| {
            // clap names an argument as its help does, which needs a built command.
            let mut built = command.clone();
            built.build();
            let arg = built.get_arguments().find(|arg| arg.to_string() == named)?;
            let place = &find(layer, arg.get_id().as_str())?.place;
            // As in the shell and in TOML.
            let equals = if place.contains(' ') { " = " } else { "=" };
            Some(format!("{place}{equals}{text}"))
        })
    })
}

/// Suggests the closest known name.
pub(crate) fn or_nearest(name: &str, known: &[String]) -> String {
    let nearest = known.iter().min_by_key(|known| strsim::damerau_levenshtein(name, known));
    nearest.map_or_else(String::new, |nearest| format!("; did you mean {nearest}?"))
}
