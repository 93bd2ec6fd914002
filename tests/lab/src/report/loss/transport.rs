//! The real server and client behind a link that loses packets. The server's log lists the packets of each frame, the
//! client's log how each mask arrived, and the referee judges pictures replayed from the client's recording.
//!
//! A tile is in time if it arrives before its frame is replaced by a newer one. Frames under way at the end of a run do
//! not count.

use std::{collections::BTreeMap, fs, net::SocketAddr, path::PathBuf};

use anyhow::{Context, Result, ensure};
use gnomon_client::{headless::stats::percentile, link::receive_options::Packets};
use gnomon_protocol::codec::CodecId;
use serde::Deserialize as _;
use serde_json::Value;
use tokio::runtime::Runtime;

use super::options::{FPS, LossOptions, Outcome};
use crate::{
    link::{self, LinkSettings, Settings},
    report::{recorded_error::Judge, shown::Shown},
    rig::{PATIENCE, ServerProcess},
};

pub(super) struct Stage<'a> {
    options: &'a LossOptions,
    server: ServerProcess,
    log: PathBuf,
    /// Bytes of the log that belong to earlier runs.
    read: usize,
    runtime: Runtime,
    folder: tempfile::TempDir,
    judge: Judge,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Sent {
    packets: u64,
    bytes: u64,
}

/// How a frame arrived, by its last report.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Received {
    packets: u64,
    missing: u64,
}

impl<'a> Stage<'a> {
    pub(super) fn new(options: &'a LossOptions, transport: &str) -> Result<Self> {
        let folder = tempfile::tempdir().context("making a temporary folder")?;
        let log = folder.path().join("server.log");
        let mut arguments = options.scene.server_arguments(transport, &options.backend, options.allow_software);
        arguments.extend(["--log".into(), "json".into(), "--log-file".into(), (&log).into()]);
        let environment = [("RUST_LOG", "warn,gnomon_server::session::driver=debug")];
        let server = ServerProcess::start_in(&options.scene.file.scene, &arguments, &environment)?;
        let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build()?;
        let judge = Judge::new(&options.scene, options.allow_software)?;
        Ok(Self { options, server, log, read: 0, runtime, folder, judge })
    }

    pub(super) fn run(&mut self, codec: CodecId, packets: Packets, settings: &Settings) -> Result<Outcome> {
        let options = self.options;
        let both = LinkSettings { up: settings.clone(), down: settings.clone(), seed: options.seed };
        let free = SocketAddr::from(([127, 0, 0, 1], 0));
        let link = self.runtime.block_on(link::server::start(free, self.server.url(), both))?;
        let url = link.url(self.server.url())?;
        let folder = tempfile::tempdir_in(self.folder.path()).context("making a temporary folder")?;
        let (mask_log, recording) = (folder.path().join("masks.log"), folder.path().join("recording"));
        let mut arguments = vec!["--cache-dir".into(), self.folder.path().join("cache").into()];
        arguments.extend(["--fps".into(), FPS.to_string().into(), "--codec".into(), codec.to_string().into()]);
        arguments.extend(["--packets".into(), packets.to_string().into(), "--mask-log".into(), (&mask_log).into()]);
        arguments.extend(["--record".into(), (&recording).into()]);
        let job = options.scene.client_job(Some(&url), folder.path(), arguments, options.allow_software);
        job.start()?.finish(PATIENCE)?.success()?;
        let (sent, received) = (self.sent()?, received(&fs::read_to_string(&mask_log)?)?);
        let mut outcome = summarise(&sent, &received, options.warm_up);
        ensure!(
            outcome.frames > 0,
            "of {} frames that were sent and {} that arrived none counts",
            sent.len(),
            received.len()
        );
        let pictures = job.stats()?.iter().map(Shown::deserialize).collect::<Result<Vec<_>, _>>()?;
        let error = self.judge.error_of(&recording, (options.warm_up, options.scene.frames), options.samples)?;
        outcome.wrong_bits = error.known_edge + error.known_inside + error.unknown;
        outcome.bits = error.relevant;
        let late = pictures.iter().skip(options.warm_up as usize).filter_map(|picture| picture.lag.map(f64::from));
        outcome.lag_p99 = percentile(&late.collect::<Vec<_>>(), 0.99);
        let down = link.counts().down;
        outcome.dropped = [down.queue_dropped, down.arrived];
        Ok(outcome)
    }

    /// Returns what the server has sent since the last call.
    fn sent(&mut self) -> Result<BTreeMap<u32, Sent>> {
        let text = fs::read_to_string(&self.log).with_context(|| format!("reading {}", self.log.display()))?;
        // The last line may be incomplete.
        let whole = text.rfind('\n').map_or(0, |end| end + 1);
        let new = text.get(self.read..whole).unwrap_or_default();
        self.read = whole;
        sent(new)
    }
}

fn sent(log: &str) -> Result<BTreeMap<u32, Sent>> {
    let mut frames = BTreeMap::new();
    for line in log.lines() {
        let line: Value = serde_json::from_str(line).with_context(|| format!("the server's log: {line}"))?;
        let fields = &line["fields"];
        if fields["message"] == "sent" {
            let frame = fields["frame"].as_str().and_then(|number| number.parse().ok()).context("a frame's number")?;
            let number = |name: &str| fields[name].as_u64().with_context(|| format!("{name} of frame {frame}"));
            frames.insert(frame, Sent { packets: number("packets")?, bytes: number("bytes")? });
        }
    }
    Ok(frames)
}

/// Reads each frame's last report.
fn received(text: &str) -> Result<BTreeMap<u32, Received>> {
    let line = |line: &str| {
        let fields: Vec<&str> = line.split(' ').collect();
        let [frame, packets, _, missing, _] = fields[..] else { anyhow::bail!("{line:?} is no line of the mask log") };
        Ok((frame.parse()?, Received { packets: packets.parse()?, missing: missing.parse()? }))
    };
    text.lines().map(line).collect()
}

/// Sums up the frames from `warm_up` to the last that can have arrived.
fn summarise(sent: &BTreeMap<u32, Sent>, received: &BTreeMap<u32, Received>, warm_up: u32) -> Outcome {
    let mut outcome = Outcome::default();
    let Some((&last, _)) = received.last_key_value() else { return outcome };
    // The last one may still be incomplete.
    for (frame, &Sent { packets, bytes }) in sent.range(warm_up.min(last)..last) {
        let received = received.get(frame).copied().unwrap_or(Received { packets: 0, missing: packets });
        outcome.frames += 1;
        outcome.frames_whole += u32::from(received.missing == 0);
        outcome.packets += packets;
        outcome.packets_used += received.packets;
        outcome.bytes += bytes;
    }
    outcome
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sent_frames_are_matched_with_received_ones() {
        let line = |frame: u32, packets: u32| {
            format!(r#"{{"fields":{{"message":"sent","frame":"{frame}","bytes":900,"packets":{packets},"parity":1}}}}"#)
        };
        let log =
            [line(0, 9), line(1, 4), r#"{"fields":{"message":"skipped"}}"#.into(), line(2, 4), line(4, 2), line(5, 1)];
        let sent = sent(&log.join("\n")).unwrap();
        assert_eq!(sent[&4], Sent { packets: 2, bytes: 900 });
        // Frame 1 arrives in part and then whole, 2 in part, 4 not at all.
        let received = received("0 9 0 0 d0\n1 3 0 1 d1\n1 4 1 0 d1\n2 1 0 3 d2\n5 1 0 0 d5\n").unwrap();
        assert_eq!(received[&1], Received { packets: 4, missing: 0 });
        let outcome = summarise(&sent, &received, 1);
        assert_eq!((outcome.frames, outcome.frames_whole, outcome.packets, outcome.packets_used), (3, 1, 10, 5));
        assert_eq!(outcome.bytes, 2700);
        assert_eq!(summarise(&sent, &BTreeMap::new(), 0).frames, 0);
        assert!(super::received("0 1 2").is_err() && super::sent("{\"fields\":{\"message\":\"sent\"}}").is_err());
    }
}
