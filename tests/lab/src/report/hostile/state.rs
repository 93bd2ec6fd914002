//! What the server holds, and what it has written: the same after an attack as before it.

use std::{
    io::{Read as _, Write as _},
    net::TcpStream,
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result};

use crate::rig::{ServerProcess, usage::usage};

/// Time until the server has forgotten an attack: an unhurried handshake (four times 1 s), its close (2 s), and quinn's
/// three probe timeouts, on a busy machine.
pub(super) const FORGETS_WITHIN: Duration = Duration::from_secs(20);

/// Most memory that garbage may cost the server.
pub(super) const MEMORY_GROWTH_BYTES: u64 = 16 << 20;

/// Memory that 400 connections may leave behind in the allocator's free lists, about half of what they hold while they
/// are open: the first attack left up to 14 MB, the others next to nothing.
pub(super) const LEFT_BEHIND_BYTES: u64 = 24 << 20;

/// A peer that is not admitted is one line, and takes four packets at least: the first, its answer to the Retry, the
/// end of the handshake, and a confirmation of the close.
pub(super) const LOG_LINES_PER_PACKET: f64 = 0.25;

/// A line of JSON with its span is shorter than 400 bytes.
pub(super) const LOG_BYTES_PER_PACKET: f64 = LOG_LINES_PER_PACKET * 400.0;

/// Lines that are no peer's: a summary of suppressed ones, a warning.
pub(super) const SPARE_LOG_LINES: u64 = 20;

#[derive(Debug, Clone, Copy)]
pub(super) struct State {
    pub(super) connections: u64,
    pub(super) resident_bytes: u64,
    pub(super) log_bytes: u64,
    /// Written and lost.
    pub(super) log_lines: u64,
    /// UDP packets received.
    pub(super) packets: u64,
}

impl State {
    pub(super) fn read(server: &mut ServerProcess, admin: &str) -> Result<Self> {
        let page = page(admin)?;
        let [_, log] = server.program().said()?;
        let sum = |name: &str| -> u64 {
            let lines = page.lines().filter(|line| line.starts_with(name));
            lines.filter_map(|line| line.rsplit_once(' ')?.1.parse::<u64>().ok()).sum()
        };
        Ok(Self {
            connections: sum("gnomon_connections{"),
            resident_bytes: usage(server.program().id())?.resident_bytes,
            log_bytes: log.len() as u64,
            log_lines: log.lines().count() as u64 + sum("gnomon_log_lines_lost_total"),
            packets: sum("gnomon_udp_received_total{"),
        })
    }

    /// Waits until no more connections are open than `before`, or [`FORGETS_WITHIN`] is over. Returns the state then,
    /// and the time that it took.
    pub(super) fn after(server: &mut ServerProcess, admin: &str, before: &Self) -> Result<(Self, Duration)> {
        let begun = Instant::now();
        loop {
            let state = Self::read(server, admin)?;
            if state.connections <= before.connections || begun.elapsed() > FORGETS_WITHIN {
                return Ok((state, begun.elapsed()));
            }
            std::thread::sleep(Duration::from_millis(50));
        }
    }
}

/// The server's metrics.
fn page(admin: &str) -> Result<String> {
    let mut stream = TcpStream::connect(admin)?;
    write!(stream, "GET /metrics HTTP/1.1\r\nHost: {admin}\r\n\r\n")?;
    let mut page = String::new();
    stream.read_to_string(&mut page)?;
    Ok(page)
}

pub(super) fn metric(admin: &str, name: &str) -> Result<u64> {
    let page = page(admin)?;
    let line =
        page.lines().find_map(|line| line.strip_prefix(name)).with_context(|| format!("no {name} in the metrics"))?;
    Ok(line.trim().parse()?)
}
