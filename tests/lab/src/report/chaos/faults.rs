//! `lab chaos faults`: lossy, corrupting and silent networks, port changes, and a killed server.

use std::{
    net::SocketAddr,
    thread::sleep,
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result};
use gnomon_client::{link::url::ServerUrl, run_headless};

use super::{
    finding::Finding,
    rebind::Rebinding,
    rig::{Probes, ServerArgs, headless},
};
use crate::link::{LinkSettings, Relay, udp};
use crate::rig::Ask;

#[derive(Debug, Clone, clap::Args)]
pub struct FaultsPart {
    #[command(flatten)]
    pub server: ServerArgs,
    /// Handshakes through each bad network.
    #[arg(long, default_value_t = 50)]
    pub handshakes: u32,
    /// Changes of the client's port.
    #[arg(long, default_value_t = 100)]
    pub rebindings: u32,
    /// Rounds of five seconds' silence and two seconds' service.
    #[arg(long, default_value_t = 4)]
    pub black_holes: u32,
}

const HANDSHAKE_PATIENCE: Duration = Duration::from_secs(60);

/// Frames of the client whose server is killed, 30 a second.
const KILLED_FRAMES: u32 = 480;

const FREE: &str = "127.0.0.1:0";

pub fn measure(part: &FaultsPart, progress: &dyn Fn(&str)) -> Result<Vec<Finding>> {
    let server = part.server.start(&[])?;
    let probes = Probes::of(&part.server, server.url())?;
    let url: ServerUrl = server.url().parse()?;
    let mut findings = Vec::new();
    for trouble in ["loss=30%", "corrupt=30%"] {
        findings.push(handshakes(part, &probes, &url, trouble)?);
        progress(&findings[findings.len() - 1].measured);
    }
    findings.push(black_hole(part, &probes, &url)?);
    progress(&findings[findings.len() - 1].measured);
    findings.push(rebindings(part, &probes, &url)?);
    progress(&findings[findings.len() - 1].measured);
    server.stop().context("stopping the server")?;
    findings.push(killed(part, progress)?);
    Ok(findings)
}

fn through(url: &ServerUrl, address: SocketAddr) -> ServerUrl {
    ServerUrl { host: address.ip().to_string(), port: address.port(), ..url.clone() }
}

fn address_of(url: &ServerUrl) -> Result<SocketAddr> {
    Ok(SocketAddr::new(url.host.parse().context("the server's address")?, url.port))
}

fn relay(probes: &Probes, url: &ServerUrl, settings: LinkSettings) -> Result<Relay> {
    let _inside = probes.handle().enter();
    Ok(udp::start(FREE.parse()?, address_of(url)?, settings)?)
}

fn handshakes(part: &FaultsPart, probes: &Probes, url: &ServerUrl, trouble: &str) -> Result<Finding> {
    let mut settings = LinkSettings { seed: 1, ..LinkSettings::default() };
    settings.up.set(trouble)?;
    settings.down.set(trouble)?;
    let (mut done, mut slowest, mut last) = (0, Duration::ZERO, String::new());
    for number in 0..part.handshakes {
        // A new link for each: relays remember clients.
        let relay = relay(probes, url, LinkSettings { seed: u64::from(number), ..settings.clone() })?;
        let begun = Instant::now();
        // One pose; its mask does not matter.
        let ask = Ask { size: (64, 36), fps: Some(20.0), frames: 1 };
        match probes.run_at(&through(url, relay.address()), ask, number, HANDSHAKE_PATIENCE) {
            Ok(_) => done += 1,
            Err(error) => last = format!("; {error}"),
        }
        slowest = slowest.max(begun.elapsed());
    }
    Ok(Finding::new(
        &format!("{0} of {0} handshakes at {trouble} each way", part.handshakes),
        format!("{done} of {}; the slowest session took {:.1} s{last}", part.handshakes, slowest.as_secs_f64()),
        done == part.handshakes,
    ))
}

fn black_hole(part: &FaultsPart, probes: &Probes, url: &ServerUrl) -> Result<Finding> {
    let mut settings = LinkSettings::default();
    let outages = (0..part.black_holes)
        .map(|round| (Duration::from_secs(2 + u64::from(round) * 7), Duration::from_secs(5)))
        .collect::<Vec<_>>();
    (settings.up.outages, settings.down.outages) = (outages.clone(), outages);
    let relay = relay(probes, url, settings)?;
    let seconds = 2 + part.black_holes * 7;
    let ask = Ask { size: (64, 36), fps: Some(20.0), frames: seconds * 20 };
    let ran = probes.run_at(&through(url, relay.address()), ask, 0, HANDSHAKE_PATIENCE);
    let goal = format!("a session outlives {} black holes, 5 s on and 2 s off", part.black_holes);
    Ok(match ran {
        Ok(report) => {
            let open = u64::from((2 + part.black_holes * 2) * 20);
            let measured =
                format!("it stayed; {} masks in {} s of open network at 20 poses a second", report.masks, open / 20);
            Finding::new(&goal, measured, report.masks * 2 >= open)
        }
        Err(error) => Finding::new(&goal, error.to_string(), false),
    })
}

fn rebindings(part: &FaultsPart, probes: &Probes, url: &ServerUrl) -> Result<Finding> {
    let period = Duration::from_millis(300);
    let relay = probes.handle().block_on(Rebinding::start(address_of(url)?, period))?;
    let ask = Ask { size: (64, 36), fps: Some(30.0), frames: part.rebindings * 9 + 30 };
    let ran = probes.run_at(&through(url, relay.address), ask, 0, HANDSHAKE_PATIENCE);
    let goal = format!("{} changes of the client's port keep the session", part.rebindings);
    Ok(match ran {
        Ok(report) => {
            let times = relay.rebindings();
            let measured = format!("it stayed through {times}; {} of {} masks", report.masks, report.poses);
            Finding::new(&goal, measured, times >= part.rebindings && report.masks * 2 > u64::from(report.poses))
        }
        Err(error) => Finding::new(&goal, format!("after {}: {error}", relay.rebindings()), false),
    })
}

/// Kills the server while a client draws, restarts it on the same port with the same certificate, and waits for the
/// client.
fn killed(part: &FaultsPart, progress: &dyn Fn(&str)) -> Result<Finding> {
    let folder = tempfile::tempdir().context("making a temporary folder")?;
    let certificate = folder.path().join("certificate");
    let certificate = certificate.to_str().context("a folder whose name is no UTF-8")?;
    let server = part.server.start(&["--cert-dir", certificate])?;
    let url: ServerUrl = server.url().parse()?;
    let listen = format!("{}:{}", url.host, url.port);
    let options = headless(&part.server, url, 30.0, KILLED_FRAMES, folder.path())?;
    let (ran, back) = std::thread::scope(|scope| {
        let client = scope.spawn(|| run_headless(&options));
        let mut server = server;
        server.program().wait_for(HANDSHAKE_PATIENCE, |said| said.find("session started"))?;
        sleep(Duration::from_secs(3));
        server.kill()?;
        progress("killed");
        sleep(Duration::from_secs(4));
        let mut again = part.server.start(&["--cert-dir", certificate, "--listen", &listen])?;
        let begun = Instant::now();
        again.program().wait_for(HANDSHAKE_PATIENCE, |said| said.find("session started"))?;
        let back = begun.elapsed();
        let ran = client.join().map_err(|_| anyhow::anyhow!("the client's thread panicked"))?;
        again.stop().context("stopping the server")?;
        Ok::<_, anyhow::Error>((ran, back))
    })?;
    let goal = "after SIGKILL and a start 4 s later the client has a session again within 3 s";
    Ok(match ran {
        Ok(summary) => Finding::new(
            goal,
            format!(
                "{:.2} s after the server listened; {} of {KILLED_FRAMES} frames drawn, {} reconnect(s), \
                 lost because: {}",
                back.as_secs_f64(),
                summary.frames_rendered,
                summary.reconnects,
                summary.connection_lost.as_deref().unwrap_or("silence")
            ),
            back <= Duration::from_secs(3) && summary.reconnects >= 1 && summary.frames_rendered == KILLED_FRAMES,
        ),
        Err(error) => Finding::new(goal, error.to_string(), false),
    })
}
