//! `lab chaos soak`: resources left behind by clients that come and go for a long time.

use std::{
    collections::BTreeMap,
    sync::{
        Mutex, PoisonError,
        atomic::{AtomicU32, Ordering},
    },
    thread::sleep,
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result};

use super::{
    finding::Finding,
    rig::{Probes, ServerArgs, mib},
};
use crate::rig::{
    Ask,
    usage::{Usage, usage},
};

#[derive(Debug, Clone, clap::Args)]
pub struct SoakPart {
    #[command(flatten)]
    pub server: ServerArgs,
    /// Sessions started per second.
    #[arg(long, default_value_t = 10.0)]
    pub rate: f64,
    /// Duration, in seconds.
    #[arg(long, default_value_t = 1800)]
    pub seconds: u32,
}

/// Mask sizes, in turn, so that buffers are reallocated too.
const SIZES: [(u32, u32); 4] = [(64, 36), (160, 90), (96, 96), (320, 180)];

/// Most probes at a time; the next one waits if all are busy.
const MOST: u32 = 64;

pub fn measure(part: &SoakPart, progress: &dyn Fn(&str)) -> Result<Vec<Finding>> {
    let mut server = part.server.start(&[])?;
    let process = server.program().id();
    let probes = Probes::of(&part.server, server.url())?;
    let (running, done, failed) = (AtomicU32::new(0), AtomicU32::new(0), Mutex::new(BTreeMap::<String, u32>::new()));
    let length = Duration::from_secs(part.seconds.into());
    let warm = length / 5;
    let (early, late) = std::thread::scope(|scope| {
        let (begun, mut early) = (Instant::now(), None::<Usage>);
        let mut number = 0_u32;
        while begun.elapsed() < length {
            let due = Duration::from_secs_f64(f64::from(number) / part.rate);
            sleep(due.saturating_sub(begun.elapsed()));
            if running.load(Ordering::Acquire) < MOST {
                running.fetch_add(1, Ordering::AcqRel);
                let ask = Ask { size: SIZES[number as usize % SIZES.len()], fps: Some(10.0), frames: 5 };
                let (running, done, failed, probes) = (&running, &done, &failed, &probes);
                scope.spawn(move || {
                    match probes.run(ask, number) {
                        Ok(_) => _ = done.fetch_add(1, Ordering::Relaxed),
                        Err(error) => {
                            let mut failed = failed.lock().unwrap_or_else(PoisonError::into_inner);
                            *failed.entry(error.to_string()).or_default() += 1;
                        }
                    }
                    running.fetch_sub(1, Ordering::AcqRel);
                });
            }
            number += 1;
            if early.is_none() && begun.elapsed() >= warm {
                early = Some(usage(process)?);
                progress("warm");
            }
        }
        while running.load(Ordering::Acquire) > 0 {
            sleep(Duration::from_millis(20));
        }
        // The server cleans up after the last sessions within its closing period.
        sleep(Duration::from_secs(3));
        Ok::<_, anyhow::Error>((early.context("the soak was too short")?, usage(process)?))
    })?;
    let (done, reasons) = (done.into_inner(), failed.into_inner().unwrap_or_else(PoisonError::into_inner));
    let failed: u32 = reasons.values().sum();
    // Addresses make many variants of one reason; three are enough.
    let reasons: String = reasons.iter().take(3).map(|(reason, times)| format!("; {times} × {reason}")).collect();
    let growth = mib(late.resident_bytes) - mib(early.resident_bytes);
    let outcome = server.stop().context("stopping the server")?;
    // A slow machine starts fewer sessions than planned, so only those that ran count.
    let sessions = outcome.stderr.matches("session ended").count();
    Ok(vec![
        Finding::new(
            &format!(
                "{} s of {} sessions a second: memory and files stay flat after a fifth of the time",
                part.seconds, part.rate
            ),
            format!(
                "{:.1} MiB then {growth:+.1}, {} files then {:+}",
                mib(early.resident_bytes),
                early.files,
                i64::try_from(late.files)? - i64::try_from(early.files)?
            ),
            growth.abs() <= 16.0 && late.files <= early.files + 4,
        ),
        Finding::new(
            "every session is served and ends",
            format!("{done} served, {failed} not; the server counted {sessions} ends{reasons}"),
            failed == 0 && sessions == done as usize,
        ),
    ])
}
