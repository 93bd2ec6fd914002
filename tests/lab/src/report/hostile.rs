//! `lab hostile`: what bad traffic costs a real server and its well-behaved clients.
//!
//! The traffic: garbage (random packets, long headers with random content, mutated and replayed first packets), first
//! packets from addresses that never answer, connections that never become sessions over both ALPNs, a flood of
//! handshakes without a Hello, and tokens that are wrong, expired or used. It comes from several addresses; a client
//! receives masks beside the garbage. `tests/lab/hostile-namespaces` runs it between two network namespaces.

mod addresses;
mod attacks;
mod flood;
mod packets;
mod peers;
mod state;
mod tokens;

use std::{
    net::IpAddr,
    sync::atomic::{AtomicBool, Ordering},
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result};
use gnomon_client::{
    app::probe::{ProbeOptions, ProbeReport, run_probe},
    camera_path::PathSpec,
    headless::stats::percentile,
    link::url::ServerUrl,
};

use self::{
    addresses::Addresses,
    attacks::Attack,
    peers::Protocol,
    state::{
        FORGETS_WITHIN, LEFT_BEHIND_BYTES, LOG_BYTES_PER_PACKET, LOG_LINES_PER_PACKET, MEMORY_GROWTH_BYTES,
        SPARE_LOG_LINES, State, metric,
    },
    tokens::Tokens,
};
use super::table::Table;
use crate::rig::{Ask, ServerProcess, usage::usage};

/// Most reply bytes per request byte to an address that never answers.
const AMPLIFICATION: f64 = 0.1;

/// Time for a good client to get its first mask during the flood.
const JOINS_WITHIN: Duration = Duration::from_secs(2);

#[derive(Debug, Clone, clap::Args)]
pub struct HostileOptions {
    /// Scene to trace: .gltf or .glb.
    #[arg(long)]
    pub scene: std::path::PathBuf,
    /// Camera path of the good client, FILE or FILE#NAME.
    #[arg(long)]
    pub path: PathSpec,
    /// Number of garbage packets.
    #[arg(long, default_value_t = 1_000_000)]
    pub packets: u32,
    /// Number of handshakes in the flood.
    #[arg(long, default_value_t = 10_000)]
    pub handshakes: usize,
    /// Number of connections of each attack before Hello.
    #[arg(long, default_value_t = 400)]
    pub connections: usize,
    /// Bytes that the peers of an attack try to send.
    #[arg(long, default_value_t = 10_000_000)]
    pub bytes: u64,
    /// Addresses to attack from. Good clients use others.
    #[arg(long, value_delimiter = ',', default_value = "127.0.0.2,127.0.0.3,127.0.0.4,127.0.0.5")]
    pub sources: Vec<IpAddr>,
    /// Address and port that the server listens on.
    #[arg(long, default_value = "127.0.0.1:0")]
    pub listen: String,
    /// The server's addresses, one a family; good clients and the lab itself use the first.
    #[arg(long, value_delimiter = ',', default_value = "127.0.0.1")]
    pub at: Vec<IpAddr>,
    /// Command that starts the server, such as `ip netns exec NAME`.
    #[arg(long, value_delimiter = ' ')]
    pub through: Vec<String>,
    /// Longest time to send garbage, in seconds.
    #[arg(long, default_value_t = 300)]
    pub seconds: u64,
    /// Report times but do not judge them, for busy machines.
    #[arg(long)]
    pub ignore_times: bool,
}

#[derive(Debug, Clone)]
pub struct HostileReport {
    /// Columns: goal, measured, wanted, holds.
    pub table: Table,
    pub holds: bool,
}

/// Runs all attacks against a server of its own.
#[expect(clippy::cast_precision_loss, reason = "counts as shares")]
pub fn run(options: &HostileOptions) -> Result<HostileReport> {
    let folder = tempfile::tempdir().context("making a temporary folder")?;
    let tokens = Tokens::write(folder.path())?;
    let path = options.path.load()?;
    let here = *options.at.first().context("--at needs an address")?;
    let arguments = [
        "--listen".to_owned(),
        options.listen.clone(),
        format!("--advertise={here}"),
        "--backend=cpu".to_owned(),
        format!("--admin={}", std::net::SocketAddr::new(here, 0)),
        "--log=json".to_owned(),
        // As long as four of these are patient.
        "--handshake-timeout-ms=1000".to_owned(),
        format!("--token-file={}", folder.path().join("tokens").display()),
    ];
    let mut server = ServerProcess::start_through(&options.through, &options.scene, &arguments, &[])?;
    let url: ServerUrl = server.url().parse()?;
    let addresses = Addresses::new(&options.sources, &options.at, url.port)?;
    let admin = server.program().wait_for(Duration::from_secs(10), admin_in)?;
    let runtime = tokio::runtime::Runtime::new().context("starting a runtime")?;
    let id = server.program().id();
    let probe = |token: &str, frames, fps| {
        let ask = Ask { size: (96, 54), fps, frames };
        let options = ProbeOptions { token: Some(token.to_owned()), ..ask.of(&url) };
        run_probe(runtime.handle(), &options, &path)
    };
    let patience = Duration::from_secs(options.seconds);
    let mut goals = Goals(Table::new("goal | measured | wanted | holds"), true);

    // Garbage beside a client.
    let quiet = probe(&tokens.good, 200, Some(20.0))?;
    let first = packets::first(runtime.handle(), &path)?;
    let before = usage(id)?.resident_bytes;
    let unowned_before = metric(&admin, "gnomon_udp_received_total{owner=\"none\"}")?;
    let done = AtomicBool::new(false);
    let (sent, disturbed) = std::thread::scope(|scope| {
        let client = scope.spawn(|| {
            let mut found = Vec::new();
            while !done.load(Ordering::Relaxed) {
                found.push(probe(&tokens.good, 200, Some(20.0)));
            }
            found
        });
        let sent = packets::garbage(&addresses, &first, options.packets, patience);
        done.store(true, Ordering::Relaxed);
        (sent, client.join())
    });
    let sent = sent?;
    let disturbed: Vec<ProbeReport> =
        disturbed.map_err(|_| anyhow::anyhow!("the client panicked"))?.into_iter().collect::<Result<_, _>>()?;
    let grown = usage(id)?.resident_bytes.saturating_sub(before);
    let counted = metric(&admin, "gnomon_udp_received_total{owner=\"none\"}")? - unowned_before
        + metric(&admin, "gnomon_udp_kernel_drops_total")?;
    goals.add("packets of garbage sent", &sent.to_string(), &options.packets.to_string(), sent == options.packets);
    goals.add(
        "of them counted by the server or dropped by the kernel, per cent",
        &format!("{:.2}", counted as f64 / f64::from(sent) * 100.0),
        "100 or more",
        counted >= u64::from(sent),
    );
    goals.add(
        "memory growth, bytes",
        &grown.to_string(),
        &format!("{MEMORY_GROWTH_BYTES} at most"),
        grown <= MEMORY_GROWTH_BYTES,
    );
    let share = |reports: &[ProbeReport]| {
        let (masks, poses) =
            reports.iter().fold((0, 0), |(masks, poses), one| (masks + one.masks, poses + u64::from(one.poses)));
        masks as f64 / poses as f64 * 100.0
    };
    let p99 = |reports: &[ProbeReport]| {
        let mut all: Vec<f64> = reports.iter().flat_map(|report| report.responses_ms.iter().copied()).collect();
        all.sort_by(f64::total_cmp);
        percentile(&all, 0.99).unwrap_or(f64::NAN)
    };
    let least = if options.ignore_times { 50.0 } else { 95.0 };
    let alone = std::slice::from_ref(&quiet);
    goals.note(
        "client alone: masks per pose, per cent; response p99, ms",
        &format!("{:.1}; {:.1}", share(alone), p99(alone)),
    );
    goals.note("client beside garbage: response p99, ms", &format!("{:.1}", p99(&disturbed)));
    goals.add(
        "client beside garbage: masks per pose, per cent",
        &format!("{:.1}", share(&disturbed)),
        &format!("{least} at least"),
        share(&disturbed) >= least,
    );

    // Addresses that never answer.
    let (asked, answered) = packets::amplification(&addresses, &first)?;
    let factor = answered as f64 / asked as f64;
    goals.add(
        "bytes to an address that never answers, over bytes from it",
        &format!("{factor:.3}"),
        &format!("{AMPLIFICATION} at most"),
        factor <= AMPLIFICATION,
    );

    // Connections that never become sessions.
    for protocol in Protocol::BOTH {
        for attack in Attack::all(protocol) {
            beleaguer(*attack, protocol, options, &addresses, (&mut server, &admin), runtime.handle(), &mut goals)?;
        }
    }

    // Handshakes without a Hello, from other addresses than the good client's.
    let flooding = AtomicBool::new(true);
    let (opened, joined) = std::thread::scope(|scope| {
        let flood = scope.spawn(|| flood::run(runtime.handle(), &addresses, options.handshakes, &flooding));
        std::thread::sleep(Duration::from_secs(1));
        let begun = Instant::now();
        let joined = probe(&tokens.good, 1, None).map(|_| begun.elapsed());
        flooding.store(false, Ordering::Relaxed);
        (flood.join(), joined)
    });
    let opened = opened.map_err(|_| anyhow::anyhow!("the flood panicked"))??;
    goals.note("handshakes of the flood until a good client was in", &opened.to_string());
    match joined {
        Ok(took) => goals.add(
            "a good client has its first mask after, s",
            &format!("{:.2}", took.as_secs_f64()),
            "2 at most",
            took <= JOINS_WITHIN || options.ignore_times,
        ),
        Err(error) => goals.add("a good client has its first mask after, s", &error.to_string(), "2 at most", false),
    }

    // Tokens.
    let once = probe(&tokens.once, 1, None).is_ok();
    goals.add("a token for one use admits", if once { "yes" } else { "no" }, "yes", once);
    for (what, token) in [
        ("a wrong token", "wrong"),
        ("an expired token", &tokens.expired),
        ("a token for one use, replayed", &tokens.once),
    ] {
        let admitted = probe(token, 1, None).is_ok();
        goals.add(&format!("{what} admits"), if admitted { "yes" } else { "no" }, "no", !admitted);
    }
    server.stop()?;
    Ok(HostileReport { table: goals.0, holds: goals.1 })
}

/// Runs one attack, and judges what it leaves behind.
#[expect(clippy::cast_precision_loss, reason = "counts")]
fn beleaguer(
    attack: Attack,
    protocol: Protocol,
    options: &HostileOptions,
    addresses: &Addresses,
    (server, admin): (&mut ServerProcess, &str),
    runtime: &tokio::runtime::Handle,
    goals: &mut Goals,
) -> Result<()> {
    let name = format!("{} over {}", attack.name(), protocol.alpn());
    let before = State::read(server, admin)?;
    let tally = runtime.block_on(attacks::run(attack, protocol, addresses, options.connections, options.bytes))?;
    let (after, took) = State::after(server, admin, &before)?;
    let done = format!("{} connected, {} refused, {} bytes", tally.connected, tally.refused, tally.bytes);
    goals.add(
        &format!("{name}: connections that the server left open"),
        &format!("{} ({done})", tally.left_open),
        "0",
        tally.left_open == 0 && tally.connected > 0,
    );
    goals.add(
        &format!("{name}: connections afterwards"),
        &format!("{} after {:.1} s", after.connections, took.as_secs_f64()),
        &format!("{} within {} s", before.connections, FORGETS_WITHIN.as_secs()),
        after.connections <= before.connections,
    );
    let grown = after.resident_bytes.saturating_sub(before.resident_bytes);
    goals.add(
        &format!("{name}: memory growth, bytes"),
        &grown.to_string(),
        &format!("{LEFT_BEHIND_BYTES} at most"),
        grown <= LEFT_BEHIND_BYTES,
    );
    let packets = (after.packets - before.packets) as f64;
    let lines = after.log_lines - before.log_lines;
    let bytes = after.log_bytes - before.log_bytes;
    goals.add(
        &format!("{name}: log lines, and bytes, per packet"),
        &format!("{:.3}, {:.1} ({packets} packets)", lines as f64 / packets, bytes as f64 / packets),
        &format!("{LOG_LINES_PER_PACKET}, {LOG_BYTES_PER_PACKET} at most"),
        lines.saturating_sub(SPARE_LOG_LINES) as f64 <= packets * LOG_LINES_PER_PACKET
            && bytes as f64 <= (packets + SPARE_LOG_LINES as f64) * LOG_BYTES_PER_PACKET,
    );
    Ok(())
}

struct Goals(Table, bool);

impl Goals {
    fn add(&mut self, goal: &str, measured: &str, wanted: &str, holds: bool) {
        let verdict = if holds { "yes" } else { "NO" };
        self.0.rows.push([goal, measured, wanted, verdict].map(str::to_owned).to_vec());
        self.1 &= holds;
    }

    fn note(&mut self, what: &str, measured: &str) {
        self.0.rows.push([what, measured, "", ""].map(str::to_owned).to_vec());
    }
}

fn admin_in(said: &str) -> Option<String> {
    let line = said.lines().find(|line| line.contains("\"admin address\""))?;
    let entry: serde_json::Value = serde_json::from_str(line).ok()?;
    Some(entry["fields"]["local_addr"].as_str()?.to_owned())
}
