//! `lab chaos drain`: a server that stops while it serves.

use std::{
    thread::sleep,
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result};
use gnomon_client::{ClientError, run_headless};
use gnomon_protocol::message::Refusal;

use super::{
    finding::Finding,
    rig::{Probes, ServerArgs, headless},
};
use crate::rig::Ask;
use crate::rig::PATIENCE;

#[derive(Debug, Clone, clap::Args)]
pub struct DrainPart {
    #[command(flatten)]
    pub server: ServerArgs,
    /// Number of drawing clients.
    #[arg(long, default_value_t = 8)]
    pub clients: u32,
    /// The server's drain period, in milliseconds.
    #[arg(long, default_value_t = 5000)]
    pub drain_ms: u32,
}

/// Frames that each client draws, 20 a second.
const FRAMES: u32 = 240;

/// Runs two servers; the first names the second when it stops.
pub fn measure(part: &DrainPart, progress: &dyn Fn(&str)) -> Result<Vec<Finding>> {
    let second = part.server.start(&[])?;
    let grace = part.drain_ms.to_string();
    let mut first = part.server.start(&["--alternative", second.url(), "--drain-ms", &grace])?;
    let probes = Probes::of(&part.server, first.url())?;
    let folder = tempfile::tempdir().context("making a temporary folder")?;
    let options = headless(&part.server, first.url().parse()?, 20.0, FRAMES, folder.path())?;
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
        // In parallel with the wait: after the server's end a newcomer gets no answer for seconds.
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
            "every client is told of the other server and moves there without losing a frame",
            format!("{moved} of {clients} moved, {whole} drew all of their frames{reasons}"),
            moved == clients && whole == clients && lost.is_empty(),
        ),
        Finding::new("no frame is half sent", format!("{incomplete} incomplete frames"), incomplete == 0),
        Finding::new(
            "nobody is admitted after the stop",
            match &newcomer {
                Ok(()) => "a newcomer was admitted".to_owned(),
                Err(error) => error.to_string(),
            },
            match &newcomer {
                Ok(()) => false,
                // A server that is gone admits nobody either.
                Err(error) => matches!(error, ClientError::Refused(Refusal::Draining)) || took < Duration::from_secs(1),
            },
        ),
        Finding::new(
            &format!(
                "it exits with 0 within its drain period of {} ms (and {} ms for closing messages)",
                part.drain_ms,
                FAREWELL.as_millis()
            ),
            format!("{} after {} ms", ended.status, took.as_millis()),
            ended.status.success() && took <= Duration::from_millis(part.drain_ms.into()) + FAREWELL,
        ),
    ])
}

/// Time for closing messages beyond the drain period.
const FAREWELL: Duration = Duration::from_secs(4);
