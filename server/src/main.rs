//! The `gnomon-server` binary: flags, logs and signals around [`gnomon_server::Server`].

use std::{io::Write as _, process::ExitCode};

use anyhow::Context as _;
use gnomon_server::{
    Server, certificate,
    cli::{self, CertificateAction, Cli, Command, SessionsAction},
    config::ServerConfig,
    logs::{self, Logs},
    sessions_command,
    signals::{Hangups, Signals},
    systemd, tokens,
};
use gnomon_settings::{Layers, Loaded};

/// Threads for encoding, beside the workers. Ample, since one session per core encodes at once.
const MAX_BLOCKING_THREADS: usize = 64;

fn main() -> ExitCode {
    let loaded = match cli::load(Layers::of_process()) {
        Ok(loaded) => loaded,
        Err(error) => return error.report("gnomon-server"),
    };
    match run(loaded) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            // Print one line, whatever the libraries put into their messages.
            let message = format!("{error:#}").split_whitespace().collect::<Vec<_>>().join(" ");
            eprintln!("gnomon-server: {message}");
            ExitCode::FAILURE
        }
    }
}

fn run(mut loaded: Loaded<Cli>) -> anyhow::Result<()> {
    let cli = &loaded.program;
    match &cli.command {
        Some(Command::Token { name, days, scope, once }) => {
            let (token, entry) = tokens::make(name, *days, scope, *once)?;
            return print_line(&format!("{token}\n{}", entry.trim_end()));
        }
        Some(Command::Sessions { admin, secret, action }) => {
            let end = action.as_ref().map(|SessionsAction::End { id }| *id);
            let said = sessions_command::run(admin.or(cli.settings.admin), secret.as_deref(), end)?;
            return print_line(&said);
        }
        Some(Command::Certificate { action, folder }) => {
            let folder = folder.as_deref().or(cli.settings.cert_dir.as_deref());
            let sha256 = match action {
                CertificateAction::Identity => certificate::make_identity(folder),
                CertificateAction::Spare => certificate::make_spare(folder),
                CertificateAction::UseSpare => certificate::use_spare(folder),
            };
            return print_line(&sha256?);
        }
        None => {}
    }
    if let Some(text) = gnomon_settings::page::<Cli, ServerConfig>(cli.completions, cli.man)? {
        return print_line(&text);
    }
    let config = &cli.settings;
    config.validate()?;
    if cli.check_config {
        let hashes = certificate::kept_browser_hashes(config).into();
        loaded.values.insert("browser_certificate_sha256".to_owned(), hashes);
        return print_line(&loaded.to_json());
    }
    let logs = logs::init(config.log, config.log_file.as_deref()).map_err(|error| anyhow::anyhow!("logs: {error}"))?;
    logs::log_panics();
    if cli.check {
        let found = Server::check(config)?;
        return print_line(&found);
    }
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .max_blocking_threads(MAX_BLOCKING_THREADS)
        .build()
        .context("cannot start the runtime")?;
    let served = runtime.block_on(serve(loaded.program.settings, &logs));
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
    systemd::ready().await;
    let _watchdog = systemd::watchdog(server.pulse());
    let reloading = async {
        loop {
            hangups.next().await;
            systemd::reloading().await;
            logs.reopen();
            server.reload();
            systemd::ready().await;
        }
    };
    let failure = tokio::select! {
        () = reloading => None,
        signal = signals.next() => {
            tracing::info!(signal, "stopping; a second signal stops at once");
            None
        }
        // End, so that a supervisor restarts the server: one that only refuses would look alive.
        reason = server.failed() => Some(reason),
    };
    systemd::stopping().await;
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

/// Prints a line on standard output at once: the program that started the server waits for it.
fn print_line(text: &str) -> anyhow::Result<()> {
    let mut out = std::io::stdout().lock();
    writeln!(out, "{text}").and_then(|()| out.flush()).context("cannot write to standard output")
}
