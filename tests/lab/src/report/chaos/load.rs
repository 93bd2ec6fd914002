//! `lab chaos load` and `idle`: many light sessions beside heavy ones, one too many, and idle sessions.

use std::{thread::sleep, time::Duration};

use anyhow::{Context as _, Result};
use gnomon_client::{ClientError, headless::stats::percentile};
use gnomon_protocol::message::Refusal;

use super::{
    finding::Finding,
    rig::{Probes, ServerArgs, joined, mib},
};
use crate::rig::{Ask, usage::usage};

#[derive(Debug, Clone, clap::Args)]
pub struct LoadPart {
    #[command(flatten)]
    pub server: ServerArgs,
    /// Light sessions: 64×36 at 10 masks a second.
    #[arg(long, default_value_t = 200)]
    pub light: u32,
    /// Heavy sessions: 640×360.
    #[arg(long, default_value_t = 4)]
    pub heavy: u32,
    /// Masks a second of a heavy session.
    #[arg(long, default_value_t = 30.0)]
    pub heavy_fps: f64,
    /// Duration, in seconds.
    #[arg(long, default_value_t = 120)]
    pub seconds: u32,
}

#[derive(Debug, Clone, clap::Args)]
pub struct IdlePart {
    #[command(flatten)]
    pub server: ServerArgs,
    /// Sessions that request one mask of 64×36 a second, as a client with a still camera does.
    #[arg(long, default_value_t = 1000)]
    pub sessions: u32,
    /// Duration, in seconds.
    #[arg(long, default_value_t = 60)]
    pub seconds: u32,
}

const LIGHT_FPS: f64 = 10.0;

const PAUSE: Duration = Duration::from_millis(15);

fn frames(fps: f64, seconds: u32) -> u32 {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "some thousands of frames")]
    let frames = (fps * f64::from(seconds)).round() as u32;
    frames.max(1)
}

pub fn measure(part: &LoadPart, progress: &dyn Fn(&str)) -> Result<Vec<Finding>> {
    let mut server = part.server.start(&[])?;
    let process = server.program().id();
    let probes = Probes::of(&part.server, server.url())?;
    let light = Ask { size: (64, 36), fps: Some(LIGHT_FPS), frames: frames(LIGHT_FPS, part.seconds) };
    let heavy = Ask { size: (640, 360), fps: Some(part.heavy_fps), frames: frames(part.heavy_fps, part.seconds) };
    let third = Duration::from_secs(u64::from(part.seconds) / 3);
    let (reports, refused, early, late) = std::thread::scope(|scope| {
        let asks =
            std::iter::repeat_n(heavy, part.heavy as usize).chain(std::iter::repeat_n(light, part.light as usize));
        let running = (0..)
            .zip(asks)
            .map(|(number, ask)| {
                sleep(PAUSE);
                Ok((ask, probes.spawn(scope, ask, number)?))
            })
            .collect::<Result<Vec<_>>>()?;
        progress("all sessions are started");
        sleep(third);
        let early = usage(process)?;
        // Asks for more than any machine has left. It must be refused, without effect on the others.
        let refused = probes.run(Ask { size: (640, 360), fps: Some(60_000.0), frames: 1 }, 0);
        sleep(third);
        let late = usage(process)?;
        let reports = running.into_iter().map(|(ask, probe)| (ask, joined(probe))).collect::<Vec<_>>();
        Ok::<_, anyhow::Error>((reports, refused, early, late))
    })?;
    let mut kept = Vec::new();
    let (mut failed, mut incomplete, mut last) = (0, 0, None);
    for (ask, report) in reports {
        match report {
            Ok(report) => {
                #[expect(clippy::cast_precision_loss, reason = "some thousands of masks")]
                kept.push((ask.size.0 == 64, report.masks as f64 / f64::from(report.poses), report.responses_ms));
                incomplete += report.incomplete;
            }
            Err(error) => {
                failed += 1;
                last = Some(format!("{error:#}"));
            }
        }
    }
    let of = |is_light: bool| {
        let shares: Vec<f64> = kept.iter().filter(|kept| kept.0 == is_light).map(|kept| kept.1).collect();
        let responses: Vec<f64> =
            kept.iter().filter(|kept| kept.0 == is_light).flat_map(|kept| kept.2.iter().copied()).collect();
        let worst = shares.iter().copied().fold(f64::INFINITY, f64::min);
        let within = shares.iter().filter(|share| **share >= 0.95).count();
        let p99 = percentile(&responses, 0.99).unwrap_or(f64::NAN);
        (shares.len(), within, worst, p99)
    };
    let mut findings = Vec::new();
    for (name, is_light, asked) in [("light", true, part.light), ("heavy", false, part.heavy)] {
        let (served, within, worst, p99) = of(is_light);
        findings.push(Finding::new(
            &format!("{asked} {name} sessions keep their rate ± 5 % for {} s", part.seconds),
            format!(
                "{within} of {served} served; the slowest got {:.1} %; pose to mask p99 {p99:.1} ms",
                worst * 100.0
            ),
            within == asked as usize,
        ));
    }
    findings.push(Finding::new(
        "nobody who was admitted is cut off; incomplete frames",
        format!("{failed} cut off or refused ({}); {incomplete} incomplete", last.as_deref().unwrap_or("none")),
        failed == 0 && incomplete == 0,
    ));
    findings.push(Finding::new(
        "one session too many is refused with a reason and a retry time",
        match &refused {
            Err(error) => error.to_string(),
            Ok(_) => "it was admitted".to_owned(),
        },
        matches!(refused, Err(ClientError::Refused(Refusal::Busy { .. }))),
    ));
    let growth = mib(late.resident_bytes) - mib(early.resident_bytes);
    findings.push(Finding::new(
        "memory is flat (± 16 MiB between a third and two thirds of the time)",
        format!("{:.1} MiB, then {growth:+.1}; {} files", mib(early.resident_bytes), late.files),
        growth.abs() <= 16.0,
    ));
    server.stop().context("stopping the server")?;
    Ok(findings)
}

pub fn measure_idle(part: &IdlePart, progress: &dyn Fn(&str)) -> Result<Vec<Finding>> {
    let mut server = part.server.start(&[])?;
    let process = server.program().id();
    let probes = Probes::of(&part.server, server.url())?;
    // Sessions must outlast the last start and the measurement.
    let start_s = PAUSE.as_secs_f64() * f64::from(part.sessions);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "some minutes")]
    let life_s = part.seconds + (start_s * 3.0) as u32 + 10;
    let ask = Ask { size: (64, 36), fps: Some(1.0), frames: life_s };
    let empty = usage(process)?;
    let (reports, before, after) = std::thread::scope(|scope| {
        let running = (0..part.sessions)
            .map(|number| {
                sleep(PAUSE);
                probes.spawn(scope, ask, number)
            })
            .collect::<Result<Vec<_>>>()?;
        progress("all sessions are started");
        sleep(Duration::from_secs(5));
        let before = usage(process)?;
        sleep(Duration::from_secs(part.seconds.into()));
        let after = usage(process)?;
        let reports: Vec<_> = running.into_iter().map(joined).collect();
        Ok::<_, anyhow::Error>((reports, before, after))
    })?;
    let served = reports.iter().filter(|report| report.is_ok()).count();
    let sessions = f64::from(part.sessions);
    let processor_ms = (after.processor - before.processor).as_secs_f64() * 1e3 / f64::from(part.seconds);
    let memory_kib = (mib(after.resident_bytes) - mib(empty.resident_bytes)) * 1024.0 / sessions;
    server.stop().context("stopping the server")?;
    Ok(vec![
        Finding::new(
            &format!("{} idle sessions stay", part.sessions),
            format!("{served} stayed for {life_s} s"),
            served == part.sessions as usize,
        ),
        Finding::new(
            "what an idle session costs (no goal: for planning)",
            format!(
                "{:.3} ms of processor time a second and {memory_kib:.0} KiB each; all together {processor_ms:.0} ms/s",
                processor_ms / sessions
            ),
            true,
        ),
    ])
}
