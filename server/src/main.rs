//! The `gnomon-server` binary: flags, logs and signals around [`gnomon_server::Server`].

use std::{io::Write as _, process::ExitCode};

use anyhow::Context as _;
use clap::Parser as _;
use gnomon_server::{
    Server,
    cli::{Cli, Command},
    config::ServerConfig,
    logs::{self, Logs},
    signals::{Hangups, Signals},
    tokens,
};

/// Threads for encoding beside the workers; as many again as encode at once is plenty.
const MAX_BLOCKING_THREADS: usize = 64;

fn main() -> ExitCode {
    let cli = Cli::parse();
    match run(&cli) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            // One line, whatever the libraries put into their messages.
            let message = format!("{error:#}").split_whitespace().collect::<Vec<_>>().join(" ");
            eprintln!("gnomon-server: {message}");
            ExitCode::FAILURE
        }
    }
}

fn run(cli: &Cli) -> anyhow::Result<()> {
    if let Some(Command::Token { name, days, scope, once }) = &cli.command {
        let (token, entry) = tokens::make(name, *days, scope, *once)?;
        return print_line(&format!("{token}\n{}", entry.trim_end()));
    }
    let config = cli.resolve()?;
    if cli.check_config {
        let text = serde_json::to_string_pretty(&config).context("cannot print the configuration")?;
        return print_line(&text);
    }
    let logs = logs::init(config.log, config.log_file.as_deref()).map_err(|error| anyhow::anyhow!("logs: {error}"))?;
    logs::log_panics();
    if cli.check {
        let found = Server::check(&config)?;
        return print_line(&found);
    }
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .max_blocking_threads(MAX_BLOCKING_THREADS)
        .build()
        .context("cannot start the runtime")?;
    let served = runtime.block_on(serve(config, &logs));
    runtime.shutdown_background();
    served
}

async fn serve(config: ServerConfig, logs: &Logs) -> anyhow::Result<()> {
    let mut signals = Signals::listen().context("cannot listen for signals")?;
    let mut hangups = Hangups::listen().context("cannot listen for signals")?;
    let server = tokio::select! {
        started = Server::start(config) => started?,
        signal = signals.next() => {
            tracing::info!(signal, "stopped before it had started");
            return Ok(());
        }
    };
    print_line(&server.url())?;
    let reloading = async {
        loop {
            hangups.next().await;
            logs.reopen();
            server.reload();
        }
    };
    let failure = tokio::select! {
        () = reloading => None,
        signal = signals.next() => {
            tracing::info!(signal, "stopping; a second signal stops at once");
            None
        }
        // A supervisor starts it again; a server that only refuses would look alive.
        reason = server.failed() => Some(reason),
    };
    tokio::select! {
        () = server.shutdown() => {}
        signal = signals.next() => anyhow::bail!("a second signal ({signal}): stopped at once"),
    }
    match failure {
        None => Ok(()),
        Some(reason) => {
            anyhow::bail!("tracing has ended: {reason}; start the server again, or trace with --backend cpu")
        }
    }
}

/// A line on standard output, at once: whoever started the server waits for it.
fn print_line(text: &str) -> anyhow::Result<()> {
    let mut out = std::io::stdout().lock();
    writeln!(out, "{text}").and_then(|()| out.flush()).context("cannot write to standard output")
}
