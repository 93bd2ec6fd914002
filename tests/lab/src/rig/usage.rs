//! A process's resources, from Linux's /proc.

use std::{fs, time::Duration};

use anyhow::{Context as _, Result};

#[derive(Debug, Clone, Copy)]
pub struct Usage {
    pub resident_bytes: u64,
    pub files: usize,
    /// Processor time of all threads since the start.
    pub processor: Duration,
}

pub fn usage(process: u32) -> Result<Usage> {
    let read = |file: &str| {
        let path = format!("/proc/{process}/{file}");
        fs::read_to_string(&path).with_context(|| format!("reading {path}"))
    };
    let status = read("status")?;
    let kib =
        status.lines().find_map(|line| line.strip_prefix("VmRSS:")?.trim().strip_suffix(" kB")?.parse::<u64>().ok());
    let stat = read("stat")?;
    // The name in parentheses may contain blanks; utime and stime are the 12th and 13th fields after it, in hundredths
    // of a second.
    let behind = stat.rsplit_once(')').context("no name in stat")?.1;
    let ticks: u64 = behind.split_whitespace().skip(11).take(2).filter_map(|ticks| ticks.parse::<u64>().ok()).sum();
    let files = fs::read_dir(format!("/proc/{process}/fd")).context("listing its files")?.count();
    let resident_bytes = kib.context("no VmRSS in status")? * 1024;
    Ok(Usage { resident_bytes, files, processor: Duration::from_millis(ticks * 10) })
}
