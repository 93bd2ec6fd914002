//! The thin client's program.

use std::{io::Write as _, process::ExitCode};

use anyhow::Context as _;
use clap::{CommandFactory as _, Parser as _};
use gnomon_client::{
    app::demo::Demo,
    cli::Arguments,
    config::{Run, resolve},
    run_headless,
    window::run_window,
};
use tracing_subscriber::EnvFilter;

fn main() -> ExitCode {
    let arguments = match Arguments::try_parse() {
        Ok(arguments) => arguments,
        // Help and version are no errors, and go to standard output.
        Err(answer) if !answer.use_stderr() => answer.exit(),
        Err(error) => {
            let text = error.to_string();
            let line = text.lines().next().unwrap_or_default();
            eprintln!("gnomon-client: {} (see --help)", line.trim_start_matches("error: "));
            return ExitCode::from(2);
        }
    };
    match run(arguments) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("gnomon-client: {}", one_line(&error));
            ExitCode::FAILURE
        }
    }
}

/// The error with what led to it, in one line. Most messages name their cause themselves; it is not said twice.
fn one_line(error: &anyhow::Error) -> String {
    error.chain().fold(String::new(), |line, cause| {
        let cause = cause.to_string().replace('\n', " ");
        match line.as_str() {
            "" => cause,
            said if said.contains(&cause) => line,
            said => format!("{said}: {cause}"),
        }
    })
}

/// Writes to standard output. A reader that has gone away, as `head` does, makes no failure.
fn print(text: &[u8]) -> anyhow::Result<()> {
    match std::io::stdout().write_all(text) {
        Err(error) if error.kind() != std::io::ErrorKind::BrokenPipe => Err(error).context("standard output"),
        _ => Ok(()),
    }
}

fn run(mut arguments: Arguments) -> anyhow::Result<()> {
    if let Some(shell) = arguments.completions {
        let mut text = Vec::new();
        clap_complete::generate(shell, &mut Arguments::command(), "gnomon-client", &mut text);
        return print(&text);
    }
    if arguments.man {
        let mut text = Vec::new();
        clap_mangen::Man::new(Arguments::command()).render(&mut text).context("--man")?;
        return print(&text);
    }
    let filter = EnvFilter::try_new(&arguments.log).with_context(|| format!("--log {:?}", arguments.log))?;
    tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr).init();
    let check_only = arguments.check_config;
    let demo = (arguments.demo && !check_only).then(Demo::start).transpose()?;
    if let Some(demo) = &demo {
        arguments.url = Some(demo.url().clone());
        if arguments.path.is_none() {
            arguments.path = Some(demo.path().parse()?);
        }
    }
    let run = resolve(arguments)?;
    match &run {
        Run::Headless(options) => options.validate()?,
        Run::Window(options) => options.run.validate()?,
    }
    if check_only {
        println!("the configuration is good");
        return Ok(());
    }
    match run {
        Run::Headless(options) => {
            let summary = run_headless(&options)?;
            print(format!("{}\n", summary.to_json()).as_bytes())?;
        }
        Run::Window(options) => run_window(options)?,
    }
    Ok(())
}
