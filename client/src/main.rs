//! The thin client's program.

use std::{io::Write as _, process::ExitCode};

use anyhow::Context as _;
use clap::Parser as _;
use gnomon_client::{cli::Arguments, config::resolve, headless::run_headless};
use tracing_subscriber::EnvFilter;

fn main() -> ExitCode {
    match run(Arguments::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            // One line, with everything that led to it.
            eprintln!("gnomon-client: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run(arguments: Arguments) -> anyhow::Result<()> {
    let filter = EnvFilter::try_new(&arguments.log).with_context(|| format!("--log {:?}", arguments.log))?;
    tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr).init();
    let check_only = arguments.check_config;
    let options = resolve(arguments)?;
    options.validate()?;
    if check_only {
        println!("the configuration is good");
        return Ok(());
    }
    let summary = run_headless(&options)?;
    // A reader that has gone away does not make the run a failure.
    let _ = writeln!(std::io::stdout(), "{}", summary.to_json());
    Ok(())
}
