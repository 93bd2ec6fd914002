//! `lab chaos fairness`: effect of one greedy client on the latency of modest ones.

use std::{thread::sleep, time::Duration};

use anyhow::{Context as _, Result};
use gnomon_client::headless::stats::percentile;

use super::{
    finding::Finding,
    rig::{Probes, ServerArgs, joined},
};
use crate::rig::Ask;

#[derive(Debug, Clone, clap::Args)]
pub struct FairnessPart {
    /// The server; with 32 lights the greedy client costs more.
    #[command(flatten)]
    pub server: ServerArgs,
    /// Modest sessions, of 320×180 at 30 masks a second.
    #[arg(long, default_value_t = 4)]
    pub modest: u32,
    /// Seconds for each of the three rounds.
    #[arg(long, default_value_t = 20)]
    pub seconds: u32,
    /// Start the greedy client first, so that it is admitted whatever it costs.
    #[arg(long)]
    pub greedy_first: bool,
}

const MODEST_FPS: u32 = 30;

/// Runs three rounds: modest clients alone, beside the greedy one, and alone again.
pub fn measure(part: &FairnessPart, progress: &dyn Fn(&str)) -> Result<Vec<Finding>> {
    let server = part.server.start(&[])?;
    let probes = Probes::of(&part.server, server.url())?;
    let modest = Ask { size: (320, 180), fps: Some(MODEST_FPS.into()), frames: MODEST_FPS * part.seconds };
    let mut rounds = Vec::new();
    let mut greedy_said = String::new();
    for (name, with_greedy) in [("alone", false), ("beside", true), ("alone again", false)] {
        let greedy = || {
            let ask = Ask { size: (1920, 1080), fps: None, frames: 1 };
            let (mut masks, mut responses) = (0, Vec::new());
            let end = std::time::Instant::now() + Duration::from_secs(u64::from(part.seconds) + 1);
            // One short session after another: a greedy client reconnects at once.
            while std::time::Instant::now() < end {
                match probes.run(Ask { frames: 50, ..ask }, 0) {
                    Ok(report) => {
                        masks += report.masks;
                        responses.extend(report.responses_ms);
                    }
                    Err(error) => return format!("{masks} masks, then: {error}"),
                }
            }
            format!("{masks} masks, response p50 {:.0} ms", percentile(&responses, 0.5).unwrap_or(f64::NAN))
        };
        let (responses, poses, masks, said) = std::thread::scope(|scope| {
            let early = (with_greedy && part.greedy_first).then(|| scope.spawn(greedy));
            if early.is_some() {
                sleep(Duration::from_millis(500));
            }
            let running =
                (0..part.modest).map(|number| probes.spawn(scope, modest, number)).collect::<Result<Vec<_>>>()?;
            if with_greedy && early.is_none() {
                sleep(Duration::from_millis(500));
            }
            let greedy = early.or_else(|| with_greedy.then(|| scope.spawn(greedy)));
            let (mut responses, mut poses, mut masks) = (Vec::new(), 0, 0);
            for probe in running {
                let report = joined(probe).context("a modest session")?;
                responses.extend(report.responses_ms);
                poses += u64::from(report.poses);
                masks += report.masks;
            }
            let said = greedy.map(|greedy| greedy.join().unwrap_or_else(|_| "its thread panicked".to_owned()));
            Ok::<_, anyhow::Error>((responses, poses, masks, said))
        })?;
        greedy_said = said.unwrap_or(greedy_said);
        let p = |share| percentile(&responses, share).unwrap_or(f64::NAN);
        progress(&format!("{name}: p50 {:.1} ms, p99 {:.1} ms, {masks} of {poses} masks", p(0.5), p(0.99)));
        rounds.push((p(0.5), p(0.99), masks, poses));
    }
    server.stop().context("stopping the server")?;
    let [alone, beside, again] = rounds.as_slice() else { anyhow::bail!("three rounds") };
    let calm = (alone.1 + again.1) / 2.0;
    let growth = beside.1 / calm - 1.0;
    Ok(vec![
        Finding::new(
            &format!("{} modest sessions' p99 grows by at most 10 % beside a greedy one", part.modest),
            format!(
                "{:.1} ms and {:.1} ms alone, {:.1} ms beside it: {:+.0} % (p50 {:.1}, {:.1}, {:.1} ms)",
                alone.1,
                again.1,
                beside.1,
                growth * 100.0,
                alone.0,
                again.0,
                beside.0
            ),
            growth <= 0.1,
        ),
        Finding::new(
            "the modest sessions' rate beside it",
            format!("{} of {} masks", beside.2, beside.3),
            beside.2 * 100 >= beside.3 * 95,
        ),
        Finding::new("the greedy client's service (1920×1080, as fast as it can; no goal)", greedy_said, true),
    ])
}
