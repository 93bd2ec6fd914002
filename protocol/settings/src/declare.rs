//! From declarations to the clap command that help, man page and completions show.

use std::{any::TypeId, fmt::Display, num::NonZeroUsize, str::FromStr};

use clap::{
    Arg, ArgAction, Args, Command, CommandFactory,
    builder::{PossibleValuesParser, TypedValueParser},
};

/// Prefix of every variable.
pub(crate) const PREFIX: &str = "GNOMON_";

/// Bounds of a number, for `#[arg(…)]`.
pub trait Bounds {
    /// Accepts numbers from `least` to `most`, and shows the range in the help.
    #[must_use]
    fn bounds<T>(self, least: T, most: T) -> Self
    where
        T: FromStr + PartialOrd + Display + Clone + Send + Sync + 'static;
}

impl Bounds for Arg {
    fn bounds<T>(self, least: T, most: T) -> Self
    where
        T: FromStr + PartialOrd + Display + Clone + Send + Sync + 'static,
    {
        let allowed = format!("{least} to {most}");
        let help = with_note(&self, &allowed);
        self.help(help).value_parser(move |text: &str| {
            let value = text.parse().ok().filter(|value| (&least..=&most).contains(&value));
            value.ok_or_else(|| format!("must be {allowed}"))
        })
    }
}

fn with_note(arg: &Arg, note: &str) -> String {
    let help = arg.get_help().map(ToString::to_string).unwrap_or_default();
    format!("{help} [{note}]")
}

/// Ids of the settings that `S` declares; they are the TOML keys.
pub(crate) fn ids<S: Args>() -> Vec<String> {
    S::augment_args(Command::new("")).get_arguments().map(|arg| arg.get_id().to_string()).collect()
}

/// Returns an argument's environment variable: its own, or derived from a setting's id.
pub(crate) fn variable(arg: &Arg, settings: &[String]) -> Option<String> {
    let declared = arg.get_env().map(|name| name.to_string_lossy().into_owned());
    let id = arg.get_id().as_str();
    declared.or_else(|| settings.iter().any(|key| key == id).then(|| format!("{PREFIX}{}", id.to_uppercase())))
}

/// Accepts only the names of these values, and lists them in help, completions and errors.
pub fn one_of<T, const N: usize>(all: [T; N]) -> impl TypedValueParser<Value = T>
where
    T: FromStr<Err: Display> + Display + Clone + Send + Sync + 'static,
{
    let names = PossibleValuesParser::new(all.map(|value| value.to_string()));
    names.try_map(|name| name.parse().map_err(|error: T::Err| error.to_string()))
}

/// Returns the command of `C`, with the settings of `S` and every variable named in the help.
#[must_use]
pub fn command<C: CommandFactory, S: Args>() -> Command {
    let settings = ids::<S>();
    C::command().mut_args(|mut arg| {
        let is_setting = settings.iter().any(|key| arg.get_id() == key.as_str());
        if is_setting && is::<bool>(&arg) {
            // `--wait` or `--wait=false`: a flag can undo a lower layer.
            if matches!(arg.get_action(), ArgAction::SetTrue) && arg.get_default_values().is_empty() {
                arg = arg.default_value("false");
            }
            arg = (arg.action(ArgAction::Set).value_parser(clap::value_parser!(bool)).value_name("BOOL"))
                .num_args(0..=1)
                .require_equals(true)
                .default_missing_value("true")
                .hide_possible_values(true);
        }
        match variable(&arg, &settings) {
            Some(name) => {
                let help = with_note(&arg, &format!("env: {name}"));
                // clap would read the process's environment itself, and accept an empty variable as a value.
                arg.env(None::<&str>).help(help)
            }
            None => arg,
        }
    })
}

/// Returns the settings with nothing set. Exits if a default breaks its own bounds; a test loads them.
#[must_use]
pub fn defaults<S: Args>() -> S {
    let command = S::augment_args(Command::new("defaults").no_binary_name(true));
    let parsed = command.try_get_matches_from([""; 0]).and_then(|matches| S::from_arg_matches(&matches));
    parsed.unwrap_or_else(|error| error.exit())
}

pub(crate) fn is<T: 'static>(arg: &Arg) -> bool {
    arg.get_value_parser().type_id() == TypeId::of::<T>()
}

pub(crate) fn is_number(arg: &Arg) -> bool {
    let numbers = [TypeId::of::<u32>(), TypeId::of::<u64>(), TypeId::of::<usize>(), TypeId::of::<NonZeroUsize>()];
    numbers.iter().any(|number| arg.get_value_parser().type_id() == *number) || is::<f32>(arg) || is::<f64>(arg)
}
