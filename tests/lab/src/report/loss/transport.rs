//! The real server and the real client behind a link that loses packets. The server's log says of every frame what was sent, the client
//! says how each mask came and records what it drew, and the referee judges pictures that are drawn again from the recording.
//!
//! A tile is in time when it is there before a newer frame takes its frame's place. The last frames of a run, which were under way when
//! it ended, do not count.

use std::{collections::BTreeMap, fs, net::SocketAddr, path::PathBuf};

use anyhow::{Context, Result, ensure};
use gnomon_client::{headless::stats::percentile, link::receive_options::Packets};
use gnomon_protocol::codec::CodecId;
use serde::Deserialize as _;
use serde_json::Value;
use tokio::runtime::Runtime;

use super::{FPS, LossOptions, Outcome};
use crate::{
    link::{Link, LinkSettings, Settings},
    report::{recorded_error::Judge, shown::Shown},
    rig::{ClientJob, PATIENCE, ServerProcess},
};

/// A server and what runs in front of it.
pub(super) struct Stage<'a> {
    options: &'a LossOptions,
    server: ServerProcess,
    log: PathBuf,
    /// Bytes of the log that earlier runs wrote.
    read: usize,
    runtime: Runtime,
    folder: tempfile::TempDir,
    judge: Judge,
}

/// What the server said of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Sent {
    packets: u64,
    bytes: u64,
}

/// What the client said of it, when it came out last.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Came {
    packets: u64,
    missing: u64,
}

impl<'a> Stage<'a> {
    pub(super) fn new(options: &'a LossOptions, transport: &str) -> Result<Self> {
        let folder = tempfile::tempdir().context("making a temporary folder")?;
        let log = folder.path().join("server.log");
        let mut arguments = options.scene.light_arguments();
        arguments.extend(["--transport".into(), transport.into(), "--backend".into(), (&options.backend).into()]);
        arguments.extend(["--log".into(), "json".into(), "--log-file".into(), (&log).into()]);
        arguments.extend(options.allow_software.then(|| "--allow-software".into()));
        let environment = [("RUST_LOG", "warn,gnomon_server::session::driver=debug")];
        let server = ServerProcess::start_in(&options.scene.scene, &arguments, &environment)?;
        let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build()?;
        let judge = Judge::new(&options.scene, options.allow_software)?;
        Ok(Self { options, server, log, read: 0, runtime, folder, judge })
    }

    pub(super) fn run(&mut self, codec: CodecId, packets: Packets, settings: &Settings) -> Result<Outcome> {
        let options = self.options;
        let both = LinkSettings { up: settings.clone(), down: settings.clone(), seed: options.seed };
        let free = SocketAddr::from(([127, 0, 0, 1], 0));
        let link = self.runtime.block_on(Link::start(free, self.server.url(), both))?;
        let url = link.url(self.server.url())?;
        let folder = tempfile::tempdir_in(self.folder.path()).context("making a temporary folder")?;
        let (mask_log, recording) = (folder.path().join("masks.log"), folder.path().join("recording"));
        let mut arguments = vec!["--cache-dir".into(), self.folder.path().join("cache").into()];
        arguments.extend(["--fps".into(), FPS.to_string().into(), "--codec".into(), codec.to_string().into()]);
        arguments.extend(["--packets".into(), packets.to_string().into(), "--mask-log".into(), (&mask_log).into()]);
        arguments.extend(["--record".into(), (&recording).into()]);
        arguments.extend(options.allow_software.then(|| "--allow-software".into()));
        let job = ClientJob {
            url: Some(&url),
            path: options.scene.path_text(),
            frames: options.scene.frames,
            size: options.scene.size,
            folder: folder.path(),
            wait: false,
            save_masks: false,
            arguments,
        };
        job.start()?.finish(PATIENCE)?.success()?;
        let (sent, came) = (self.sent()?, came(&fs::read_to_string(&mask_log)?)?);
        let mut outcome = counted(&sent, &came, options.warm_up);
        ensure!(outcome.frames > 0, "of {} frames that were sent and {} that came none counts", sent.len(), came.len());
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

    /// What the server has sent since it was asked last.
    fn sent(&mut self) -> Result<BTreeMap<u32, Sent>> {
        let text = fs::read_to_string(&self.log).with_context(|| format!("reading {}", self.log.display()))?;
        // A line may still be in the making.
        let whole = text.rfind('\n').map_or(0, |end| end + 1);
        let new = text.get(self.read..whole).unwrap_or_default();
        self.read = whole;
        sent(new)
    }
}

/// The frames that a log says were sent.
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

/// How the frames came, each as it came out last.
fn came(text: &str) -> Result<BTreeMap<u32, Came>> {
    let line = |line: &str| {
        let numbers: Vec<u64> = line.split(' ').map(str::parse).collect::<Result<_, _>>()?;
        let [frame, packets, _, missing] = numbers[..] else { anyhow::bail!("{line:?} is no frame that came") };
        Ok((u32::try_from(frame)?, Came { packets, missing }))
    };
    text.lines().map(line).collect()
}

/// What came of the frames from `warm_up` to the last that can have come.
fn counted(sent: &BTreeMap<u32, Sent>, came: &BTreeMap<u32, Came>, warm_up: u32) -> Outcome {
    let mut outcome = Outcome::default();
    let Some((&last, _)) = came.last_key_value() else { return outcome };
    // The last one is not settled yet.
    for (frame, &Sent { packets, bytes }) in sent.range(warm_up.min(last)..last) {
        let came = came.get(frame).copied().unwrap_or(Came { packets: 0, missing: packets });
        outcome.frames += 1;
        outcome.frames_whole += u32::from(came.missing == 0);
        outcome.packets += packets;
        outcome.packets_used += came.packets;
        outcome.bytes += bytes;
    }
    outcome
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_sent_is_held_against_what_came() {
        let line = |frame: u32, packets: u32| {
            format!(
                r#"{{"level":"DEBUG","fields":{{"message":"sent","frame":"{frame}","bytes":900,"packets":{packets},"parity":1}}}}"#
            )
        };
        let log =
            [line(0, 9), line(1, 4), r#"{"fields":{"message":"skipped"}}"#.into(), line(2, 4), line(4, 2), line(5, 1)];
        let sent = sent(&log.join("\n")).unwrap();
        assert_eq!(sent[&4], Sent { packets: 2, bytes: 900 });
        // Frame 1 first in part and then whole, 2 in part, 4 not at all.
        let came = came("0 9 0 0\n1 3 0 1\n1 4 1 0\n2 1 0 3\n5 1 0 0\n").unwrap();
        assert_eq!(came[&1], Came { packets: 4, missing: 0 });
        let outcome = counted(&sent, &came, 1);
        assert_eq!((outcome.frames, outcome.frames_whole, outcome.packets, outcome.packets_used), (3, 1, 10, 5));
        assert_eq!(outcome.bytes, 2700);
        assert_eq!(counted(&sent, &BTreeMap::new(), 0).frames, 0);
        assert!(super::came("0 1 2").is_err() && super::sent("{\"fields\":{\"message\":\"sent\"}}").is_err());
    }
}
