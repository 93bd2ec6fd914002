//! Combines the layers.

use std::{
    collections::BTreeMap,
    ffi::{OsStr, OsString},
    path::{Path, PathBuf},
};

use clap::{ArgMatches, Args, Command, CommandFactory, Parser, parser::ValueSource};

use crate::{
    declare::{self, PREFIX, command, ids, is, is_number},
    error::SettingsError,
    file,
    layer::{self, Value, or_nearest},
    variables,
};

/// Where a setting's value comes from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Source {
    Default,
    File,
    /// The variable's name.
    Environment(String),
    Flag,
}

/// What a program loads its settings from.
#[derive(Debug, Clone)]
pub struct Layers {
    /// The command line, including the program's name.
    pub arguments: Vec<OsString>,
    /// The environment. Empty variables count as unset.
    pub environment: Vec<(OsString, OsString)>,
    /// The TOML file to read if `--config` names none.
    pub own_file: Option<PathBuf>,
    /// True if relative paths in the file start from its folder instead of the working directory.
    pub paths_from_file: bool,
}

#[derive(Debug)]
pub struct Loaded<C> {
    /// The parsed command line with every layer applied.
    pub program: C,
    /// Where each setting's value comes from, by its key.
    pub sources: BTreeMap<String, Source>,
    /// Every setting's effective value, by its key, as `--check-config` prints it. Secrets are hidden.
    pub values: BTreeMap<String, serde_json::Value>,
}

impl<C> Loaded<C> {
    /// Returns effective values and their sources, for `--check-config`.
    #[must_use]
    pub fn to_json(&self) -> String {
        let mut all = serde_json::to_value(&self.values).unwrap_or_default();
        let named = self.sources.iter().map(|(key, source)| {
            let source = match source {
                Source::Default => "default",
                Source::File => "file",
                Source::Environment(name) => name,
                Source::Flag => "flag",
            };
            (key.clone(), source.into())
        });
        all["sources"] = serde_json::Value::Object(named.collect());
        format!("{all:#}")
    }
}

impl Layers {
    /// Returns the process's own command line and environment.
    #[must_use]
    pub fn of_process() -> Self {
        Self {
            arguments: std::env::args_os().collect(),
            environment: std::env::vars_os().collect(),
            own_file: None,
            paths_from_file: false,
        }
    }

    /// Returns a test's command line and environment.
    #[must_use]
    pub fn of(arguments: &[&str], environment: &[(&str, &str)]) -> Self {
        Self {
            arguments: arguments.iter().map(OsString::from).collect(),
            environment: environment.iter().map(|(name, text)| (name.into(), text.into())).collect(),
            own_file: None,
            paths_from_file: false,
        }
    }

    /// Loads the program `C`, whose settings are those of `S`. `--config`, if `C` declares it, names the TOML file.
    ///
    /// # Errors
    /// Errors name the wrong flag, variable or key. [`SettingsError::Answer`] for `--help` and `--version`.
    pub fn load<C: Parser, S: Args>(&self) -> Result<Loaded<C>, SettingsError> {
        let command = command::<C, S>();
        let keys = ids::<S>();
        let flags = command.clone().try_get_matches_from(&self.arguments).map_err(|error| {
            SettingsError::of_layer(error, |arg, value| {
                let flag = arg.split([' ', '[', '=']).next().filter(|_| !value.is_empty())?;
                Some(format!("{} {value}", flag.trim_matches(['<', '>'])))
            })
        })?;
        let environment = self.variables::<C>(&keys)?;
        let from_environment = layer::parse_alone(&command, &environment)?;
        let config = |matches: &ArgMatches| matches.try_get_one::<PathBuf>("config").ok().flatten().cloned();
        let path = config(&flags).or_else(|| config(&from_environment)).or_else(|| self.own_file.clone());
        let mut file = path.as_deref().map_or(Ok(Vec::new()), |path| file::read(path, &command, &keys))?;
        if let Some(folder) = path.as_deref().and_then(Path::parent).filter(|_| self.paths_from_file) {
            for value in &mut file {
                if command.get_arguments().any(|arg| arg.get_id() == value.id.as_str() && is::<PathBuf>(arg)) {
                    value.text = folder.join(&value.text).into();
                }
            }
        }
        layer::parse_alone(&command, &file)?;
        let layered = layer::apply(layer::apply(command.clone(), &file), &environment);
        let wrong = |error| SettingsError::of_layer(error, |_, _| None);
        let matches = layered.try_get_matches_from(&self.arguments).map_err(wrong)?;
        let program = C::from_arg_matches(&matches).map_err(wrong)?;
        let source = |key: &str| match (matches.value_source(key), layer::find(&environment, key)) {
            (Some(ValueSource::CommandLine), _) => Source::Flag,
            (_, Some(variable)) => Source::Environment(variable.place.clone()),
            _ if layer::find(&file, key).is_some() => Source::File,
            _ => Source::Default,
        };
        let sources = keys.iter().map(|key| (key.clone(), source(key))).collect();
        let values = keys.iter().map(|key| (key.clone(), effective(&command, &matches, key))).collect();
        Ok(Loaded { program, sources, values })
    }

    /// Returns the variables that are set and not empty. An unknown `GNOMON_` variable is an error.
    fn variables<C: CommandFactory>(&self, keys: &[String]) -> Result<Vec<Value>, SettingsError> {
        let declared: Vec<_> = (C::command().get_arguments())
            .filter_map(|arg| Some((arg.get_id().to_string(), declare::variable(arg, keys)?)))
            .collect();
        let mut values = Vec::new();
        for (name, text) in self.environment.iter().filter(|(_, text)| !text.is_empty()) {
            let name = name.to_string_lossy();
            match declared.iter().find(|(_, variable)| *variable == name) {
                Some((id, _)) => {
                    values.push(Value { id: id.clone(), text: text.clone(), place: name.into_owned() });
                }
                // Names of variables are in capitals, so others with our prefix are mistakes, too.
                None if name.to_uppercase().starts_with(PREFIX)
                    && !variables::is_known(&name, &text.to_string_lossy()) =>
                {
                    let names: Vec<_> = declared.iter().map(|(_, name)| name.clone()).collect();
                    let hint = or_nearest(&name.to_uppercase(), &names);
                    return Err(SettingsError::Value(format!("unknown environment variable {name}{hint}")));
                }
                None => {}
            }
        }
        Ok(values)
    }
}

/// Returns a setting's value as JSON: numbers and booleans unchanged, anything else as text.
fn effective(command: &Command, matches: &ArgMatches, key: &str) -> serde_json::Value {
    let arg = command.get_arguments().find(|arg| arg.get_id() == key);
    let text = matches.get_raw(key).and_then(|mut all| all.next()).map(OsStr::to_string_lossy);
    match (arg, text) {
        (Some(arg), Some(_)) if arg.is_hide_env_values_set() => "(hidden)".into(),
        (Some(arg), Some(text)) if is_number(arg) || is::<bool>(arg) => {
            serde_json::from_str(&text).unwrap_or_else(|_| text.into())
        }
        (_, Some(text)) => text.into(),
        (_, None) => serde_json::Value::Null,
    }
}

/// Reads settings from a TOML text alone.
///
/// # Errors
/// Errors name the line and the wrong key, on one line.
pub fn parse_toml<S: Args>(text: &str) -> Result<S, SettingsError> {
    let command = S::augment_args(Command::new("settings"));
    let values = file::parse(text, &command, &ids::<S>()).map_err(SettingsError::Value)?;
    let matches = layer::parse_alone(&command, &values)?;
    S::from_arg_matches(&matches).map_err(|error| SettingsError::of_layer(error, |_, _| None))
}
