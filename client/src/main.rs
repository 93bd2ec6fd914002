//! The `gnomon-client` binary.

use std::{io::Write as _, process::ExitCode};

use anyhow::Context as _;
use gnomon_client::{
    ClientError,
    app::signals,
    cli::{self, Arguments, Run, resolve},
    config::ClientSettings,
    link::scene_cache::SceneCache,
    run_headless_until,
    stop::{Cause, Stop},
};
#[cfg(feature = "window")]
use gnomon_client::{app::demo::Demo, target::Target, window::run_window};
use gnomon_protocol::text::Escaped;
use gnomon_settings::{Layers, Loaded};
use tracing_subscriber::EnvFilter;

fn main() -> ExitCode {
    let loaded = match cli::load(Layers::of_process()) {
        Ok(loaded) => loaded,
        Err(error) => return error.report("gnomon-client"),
    };
    let stop = Stop::default();
    match run(loaded, &stop) {
        Err(error) if !matches!(error.downcast_ref(), Some(ClientError::Stopped(_))) => {
            // A terminal that is lost takes no line, and `eprintln` would panic.
            let _ = writeln!(std::io::stderr(), "gnomon-client: {}", one_line(&error));
            ExitCode::FAILURE
        }
        _ => stop.asked().map_or(ExitCode::SUCCESS, |cause| cause.exit_code().into()),
    }
}

/// Returns the error and its causes in one line, without causes that a message already contains.
fn one_line(error: &anyhow::Error) -> String {
    error.chain().fold(String::new(), |line, cause| {
        // A cause of a lost connection repeats what the peer wrote.
        let cause = Escaped(cause.to_string().replace('\n', " ")).to_string();
        match line.as_str() {
            "" => cause,
            text if text.contains(&cause) => line,
            text => format!("{text}: {cause}"),
        }
    })
}

/// Writes a line to standard output. A closed pipe, as after `head`, is no error.
fn print(text: &str) -> anyhow::Result<()> {
    match writeln!(std::io::stdout(), "{text}") {
        Err(error) if error.kind() != std::io::ErrorKind::BrokenPipe => Err(error).context("standard output"),
        _ => Ok(()),
    }
}

#[cfg(not(feature = "window"))]
const NO_WINDOW: &str =
    "this gnomon-client is built without its window: pass --headless, or `cargo build --release -p gnomon-client`";

fn run(loaded: Loaded<Arguments>, stop: &Stop) -> anyhow::Result<()> {
    let arguments = &loaded.program;
    if let Some(page) = gnomon_settings::page::<Arguments, ClientSettings>(arguments.completions, arguments.man)? {
        return print(&page);
    }
    if arguments.clear_cache {
        let cache = SceneCache::new(arguments.settings.cache_dir.clone(), arguments.settings.cache_limit());
        return print(&cache.clear().context("--clear-cache")?.to_string());
    }
    let filter = EnvFilter::try_new(&arguments.log).with_context(|| format!("--log {:?}", arguments.log))?;
    let colour = gnomon_settings::wants_colour(&std::io::stderr());
    let log = tracing_subscriber::fmt().with_env_filter(filter).with_ansi(colour).with_writer(std::io::stderr);
    // A closed pipe or a lost terminal would be told on standard error, which is that pipe: a panic.
    log.log_internal_errors(false).init();
    if arguments.check_config {
        let report = loaded.to_json();
        resolve(loaded)?.validate()?;
        return print(&report);
    }
    signals::watch(stop).context("watching for signals")?;
    if arguments.demo {
        #[cfg(feature = "window")]
        return run_demo(loaded, stop);
        #[cfg(not(feature = "window"))]
        anyhow::bail!(NO_WINDOW);
    }
    run_resolved(loaded, stop)
}

/// Runs the client with a local server that stops at the end.
#[cfg(feature = "window")]
fn run_demo(mut loaded: Loaded<Arguments>, stop: &Stop) -> anyhow::Result<()> {
    let reading = &mut loaded.program.reading;
    let (animation, editable) = (reading.animation.take(), reading.editable.take());
    let settings = &mut loaded.program.settings;
    let demo = Demo::start(animation, editable.as_deref(), settings.adapter.as_deref())?;
    settings.url = Some(Target::Server(demo.url().clone()));
    if settings.path.is_none() {
        settings.path = Some(demo.path().parse()?);
    }
    run_resolved(loaded, stop)
}

fn run_resolved(loaded: Loaded<Arguments>, stop: &Stop) -> anyhow::Result<()> {
    let run = resolve(loaded)?;
    run.validate()?;
    match run {
        Run::Headless(options) => {
            let summary = run_headless_until(&options, stop)?;
            let printed = print(&summary.to_json());
            // A lost terminal takes no summary, and its loss is why the run ends.
            if stop.asked() != Some(Cause::HangUp) {
                printed?;
            }
            summary.lost_at_end.map_or(Ok(()), |reason| Err(ClientError::EndedAlone(reason).into()))
        }
        #[cfg(feature = "window")]
        Run::Window(options) => Ok(run_window(options, stop)?),
        #[cfg(not(feature = "window"))]
        Run::Window(_) => anyhow::bail!(NO_WINDOW),
    }
}
