//! A server that is told to stop while it serves: who hears it, who is admitted, what becomes of the frames, and how it ends.

use std::{
    thread::sleep,
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result};
use gnomon_client::{ClientError, HeadlessOptions, Source, link::url::ServerUrl, run_headless};
use gnomon_protocol::message::Refusal;

use super::{
    Finding, ServerArgs,
    rig::{Ask, Probes},
};
use crate::rig::PATIENCE;

/// Options of `lab chaos drain`.
#[derive(Debug, Clone, clap::Args)]
pub struct DrainPart {
    /// The server.
    #[command(flatten)]
    pub server: ServerArgs,
    /// Clients that draw while the server stops.
    #[arg(long, default_value_t = 8)]
    pub clients: u32,
    /// The server's grace, in milliseconds.
    #[arg(long, default_value_t = 5000)]
    pub drain_ms: u32,
}

/// Frames that each client draws, 20 a second.
const FRAMES: u32 = 240;

/// Runs two servers: the first one names the second one when it stops.
///
/// # Errors
/// When a server or a client cannot be started.
pub fn measure(part: &DrainPart, progress: &dyn Fn(&str)) -> Result<Vec<Finding>> {
    let second = part.server.start(&[])?;
    let grace = part.drain_ms.to_string();
    let mut first = part.server.start(&["--alternative", second.url(), "--drain-ms", &grace])?;
    let probes = Probes::of(&part.server, first.url())?;
    let folder = tempfile::tempdir().context("making a temporary folder")?;
    let mut options = HeadlessOptions::new(Source::Server(first.url().parse::<ServerUrl>()?));
    (options.width, options.height, options.fps, options.frames) = (64, 36, Some(20.0), Some(FRAMES));
    options.path = Some(part.server.scene.path_text().to_str().context("a path that is no UTF-8")?.parse()?);
    options.cache_dir = Some(folder.path().join("cache"));
    options.allow_software = true;
    let clients = part.clients as usize;
    let (summaries, newcomer, ended, took) = std::thread::scope(|scope| {
        let running: Vec<_> = (0..clients).map(|_| scope.spawn(|| run_headless(&options))).collect();
        first
            .program()
            .wait_for(PATIENCE, |said| (said.matches("session started").count() >= clients).then_some(()))?;
        sleep(Duration::from_secs(2));
        progress("all clients draw");
        let begun = Instant::now();
        first.program().terminate()?;
        sleep(Duration::from_millis(100));
        // Beside the wait for the server's end: a newcomer to a server that has gone already hears nothing for seconds.
        let newcomer = scope.spawn(|| probes.run(Ask { size: (64, 36), fps: Some(10.0), frames: 1 }, 0).map(drop));
        let ended = first.wait(PATIENCE)?;
        let took = begun.elapsed();
        let newcomer = newcomer.join().map_err(|_| anyhow::anyhow!("the newcomer's thread panicked"))?;
        let summaries: Vec<_> = running
            .into_iter()
            .map(|client| client.join().map_err(|_| anyhow::anyhow!("a client's thread panicked")))
            .collect();
        Ok::<_, anyhow::Error>((summaries, newcomer, ended, took))
    })?;
    second.stop().context("stopping the second server")?;
    let (mut moved, mut whole, mut incomplete, mut lost) = (0, 0, 0, Vec::new());
    for summary in summaries {
        match summary? {
            Ok(summary) => {
                moved += usize::from(summary.reconnects == 1);
                whole += usize::from(summary.frames_rendered == FRAMES);
                incomplete += summary.frames_incomplete;
                lost.extend(summary.connection_lost);
            }
            Err(error) => lost.push(error.to_string()),
        }
    }
    let reasons = lost.first().map(|reason| format!(", {} lost a server: {reason}", lost.len())).unwrap_or_default();
    Ok(vec![
        Finding::new(
            "every client is told and goes to the server that is named, without a frame less",
            format!("{moved} of {clients} moved, {whole} drew all of their frames{reasons}"),
            moved == clients && whole == clients && lost.is_empty(),
        ),
        Finding::new("no frame is half sent", format!("{incomplete} incomplete frames"), incomplete == 0),
        Finding::new(
            "nobody is admitted any more",
            match &newcomer {
                Ok(()) => "a newcomer was admitted".to_owned(),
                Err(error) => error.to_string(),
            },
            match &newcomer {
                Ok(()) => false,
                // It may have gone already: then nobody is admitted either.
                Err(error) => matches!(error, ClientError::Refused(Refusal::Draining)) || took < Duration::from_secs(1),
            },
        ),
        Finding::new(
            &format!(
                "it exits with 0 within its grace of {} ms (and {} ms for farewells)",
                part.drain_ms,
                FAREWELL.as_millis()
            ),
            format!("{} after {} ms", ended.status, took.as_millis()),
            ended.status.success() && took <= Duration::from_millis(part.drain_ms.into()) + FAREWELL,
        ),
    ])
}

/// Time that last words may take beyond the grace.
const FAREWELL: Duration = Duration::from_secs(4);
