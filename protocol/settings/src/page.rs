//! A program's man page and completions, and a check that they are complete.

use std::io;

use clap::{Args, CommandFactory};
use clap_complete::Shell;

use crate::{
    declare::{PREFIX, command, ids, variable},
    error::one_line,
    file,
};

/// Returns the completions or the man page of `C`, as requested.
///
/// # Errors
/// Errors if the page cannot be written.
pub fn page<C: CommandFactory, S: Args>(completions: Option<Shell>, man: bool) -> io::Result<Option<String>> {
    let mut command = command::<C, S>();
    let mut text = Vec::new();
    match completions {
        Some(shell) => {
            let name = command.get_name().to_owned();
            clap_complete::generate(shell, &mut command, name, &mut text);
        }
        None if man => clap_mangen::Man::new(command).render(&mut text)?,
        None => return Ok(None),
    }
    Ok(Some(String::from_utf8_lossy(&text).trim_end().to_owned()))
}

/// For the tests of `C`: lists what is missing. Each setting must be in the help, the man page and the TOML keys, and
/// its variable in `listed`, one of [`crate::variables`].
#[must_use]
pub fn problems<C: CommandFactory, S: Args>(listed: &str) -> Vec<String> {
    C::command().debug_assert();
    let mut command = command::<C, S>();
    let keys = ids::<S>();
    let help = one_line(&command.render_long_help().to_string());
    // roff escapes each hyphen.
    let man = page::<C, S>(None, true).ok().flatten().unwrap_or_default().replace('\\', "");
    let mut problems = Vec::new();
    let mut require = |holds: bool, what: String| {
        if !holds {
            problems.push(what);
        }
    };
    for key in &keys {
        let of_type = file::parse(&format!("{key} = []"), &command, &keys).err().unwrap_or_default();
        require(of_type.contains("must be"), format!("{key}: TOML says {of_type:?}"));
        let name = (command.get_arguments().find(|arg| arg.get_id() == key.as_str()))
            .map(|arg| arg.get_long().map_or(arg.get_id().to_string(), |long| format!("--{long}")))
            .unwrap_or_default();
        let flag = key.replace('_', "-");
        require(name == *key || name == format!("--{flag}"), format!("{key}: its flag is {name}"));
        for (page, text) in [("--help", &help), ("--man", &man)] {
            require(text.to_lowercase().contains(&name), format!("{key}: not in {page}"));
        }
    }
    let declared = C::command();
    let variables: Vec<_> = declared.get_arguments().filter_map(|arg| variable(arg, &keys)).collect();
    let listed: Vec<_> = listed.split_whitespace().map(|name| format!("{PREFIX}{name}")).collect();
    for name in variables.iter().filter(|name| name.starts_with(PREFIX)) {
        require(listed.contains(name), format!("{name}: not in gnomon_settings::variables"));
        require(help.contains(&format!("[env: {name}]")), format!("{name}: not in --help"));
    }
    for name in &listed {
        require(variables.contains(name), format!("{name}: no setting has this variable"));
    }
    problems
}
