//! `lab chaos devices`: panics and lost devices, injected into a server in this process.

use std::{
    sync::atomic::{AtomicBool, Ordering},
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result, bail, ensure};
use gnomon_client::headless::stats::{millis, percentile};
use gnomon_protocol::{ids::FrameNumber, mask::MaskShape};
use gnomon_scene::{SceneAt, camera::Camera};
use gnomon_server::{
    RunningServer, Server,
    config::{Backend, ServerConfig},
    visibility::{
        TraceRequest,
        engine::{Engine, Fault, SessionPort},
    },
};

use super::{
    finding::Finding,
    rig::{Probes, ServerArgs, joined},
};
use crate::rig::Ask;

#[derive(Debug, Clone, clap::Args)]
pub struct DevicesPart {
    #[command(flatten)]
    pub server: ServerArgs,
    /// Panics, each in another session's work.
    #[arg(long, default_value_t = 1000)]
    pub panics: u32,
    /// Device losses.
    #[arg(long, default_value_t = 100)]
    pub losses: u32,
    /// Seconds to measure the total rate, if there are several devices.
    #[arg(long, default_value_t = 10)]
    pub seconds: u32,
}

const PATIENCE: Duration = Duration::from_secs(60);

/// Time to trace again after a device loss.
const BACK_WITHIN: Duration = Duration::from_secs(2);

/// Measures panics and losses, and compares one device with all if there are several.
pub fn measure(part: &DevicesPart, progress: &dyn Fn(&str)) -> Result<Vec<Finding>> {
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().context("the server's threads")?;
    let folder = tempfile::tempdir().context("making a temporary folder")?;
    let server =
        runtime.block_on(Server::start(config(&part.server, folder.path())?)).context("starting the server")?;
    let probes = Probes::of(&part.server, &server.url())?;
    let mut findings = vec![panics(part, &server, &probes)?];
    progress(&findings[0].measured);
    findings.extend(losses(part, &server, &probes)?);
    progress(&findings[1].measured);
    if server.engines().len() > 1 {
        findings.extend(several(part, &server, &probes)?);
    }
    runtime.block_on(server.shutdown());
    Ok(findings)
}

fn config(server: &ServerArgs, folder: &std::path::Path) -> Result<ServerConfig> {
    let backend = <Backend as clap::ValueEnum>::from_str(&server.backend, true).map_err(anyhow::Error::msg)?;
    Ok(ServerConfig {
        scene: Some(server.scene.file.scene.clone()),
        lights_from: server.scene.file.lights_from.clone(),
        lights: server.scene.file.lights,
        listen: "127.0.0.1:0".parse()?,
        backend,
        allow_software: server.allow_software,
        devices: server.devices.and_then(|devices| usize::try_from(devices).ok()).and_then(std::num::NonZeroUsize::new),
        device_budget_ms: server.device_budget_ms,
        cert_dir: Some(folder.join("certificate")),
        drain_ms: 0,
        max_sessions: 4096,
        ..ServerConfig::default()
    })
}

/// Runs sessions that each panic at their first pose, then one that must be served.
fn panics(part: &DevicesPart, server: &RunningServer, probes: &Probes) -> Result<Finding> {
    let one = Ask { size: (64, 36), fps: None, frames: 1 };
    // Keeps a thousand expected panics off the terminal.
    let hook = std::panic::take_hook();
    std::panic::set_hook(Box::new(|_| {}));
    let mut closed = 0;
    for number in 0..part.panics {
        // Only the engine that gets the pose panics; the others must forget the fault before the next session.
        for engine in server.engines() {
            engine.inject(Fault::Panic);
        }
        closed += u32::from(probes.run(one, number).is_err());
        for engine in server.engines() {
            engine.forget_faults();
        }
    }
    std::panic::set_hook(hook);
    let after = probes.run(Ask { frames: 10, ..one }, 0);
    let losses: u64 = server.engines().iter().map(Engine::losses).sum();
    let serves = after.as_ref().is_ok_and(|report| report.masks == 10);
    Ok(Finding::new(
        &format!("{} panics in sessions' work close these sessions only", part.panics),
        format!("{closed} sessions closed; the next one was served: {serves}; devices lost by it: {losses}"),
        closed == part.panics && serves && losses == 0,
    ))
}

/// Loses devices one after the other under two sessions: one inside the engine, which times each recovery, and a
/// client's.
fn losses(part: &DevicesPart, server: &RunningServer, probes: &Probes) -> Result<Vec<Finding>> {
    let ended = AtomicBool::new(false);
    let (took_ms, client) = std::thread::scope(|scope| {
        let client = scope.spawn(|| {
            let mut sessions = 0;
            // Sessions of a few seconds, repeated: each must live to its end.
            while !ended.load(Ordering::Acquire) {
                probes
                    .run(Ask { size: (64, 36), fps: Some(10.0), frames: 50 }, 1)
                    .map_err(|error| error.to_string())?;
                sessions += 1;
            }
            Ok::<u32, String>(sessions)
        });
        let took = each_loss(part, server);
        ended.store(true, Ordering::Release);
        let client = client.join().unwrap_or_else(|_| Err("its thread panicked".to_owned()));
        Ok::<_, anyhow::Error>((took?, client))
    })?;
    let slowest = percentile(&took_ms, 1.0).unwrap_or(f64::NAN);
    let counted: u64 = server.engines().iter().map(Engine::losses).sum();
    Ok(vec![
        Finding::new(
            &format!("{} lost devices: serving again within 2 s each", part.losses),
            format!(
                "{} masks came from new devices, after {:.0} ms (median) and {slowest:.0} ms (slowest); \
                 {counted} losses counted",
                took_ms.len(),
                percentile(&took_ms, 0.5).unwrap_or(f64::NAN)
            ),
            took_ms.len() == part.losses as usize
                && slowest <= millis(BACK_WITHIN)
                && counted == u64::from(part.losses),
        ),
        Finding::new(
            "a client's sessions outlive them",
            match &client {
                Ok(sessions) => format!("{sessions} sessions of 5 s, none cut off"),
                Err(error) => error.clone(),
            },
            client.is_ok(),
        ),
    ])
}

fn each_loss(part: &DevicesPart, server: &RunningServer) -> Result<Vec<f64>> {
    let lights = server.lights();
    let shape = MaskShape::new(64, 36, lights)?;
    let mut took_ms = Vec::new();
    for number in 0..part.losses {
        let engines = server.engines();
        let engine = &engines[number as usize % engines.len()];
        let mut port = engine.open_session(shape)?;
        let before = engine.losses();
        request(&mut port, shape, 0);
        await_mask(&mut port)?;
        let begun = Instant::now();
        engine.inject(Fault::DeviceLost);
        while engine.losses() == before {
            ensure!(begun.elapsed() < PATIENCE, "the device was not lost");
            std::thread::sleep(Duration::from_millis(1));
        }
        request(&mut port, shape, 1);
        await_mask(&mut port)?;
        took_ms.push(millis(begun.elapsed()));
        while !engine.is_well() {
            ensure!(begun.elapsed() < PATIENCE, "the device did not come back");
            std::thread::sleep(Duration::from_millis(1));
        }
    }
    Ok(took_ms)
}

/// Compares all devices with one: masks a second of sessions that never wait, and where sessions go when a device is
/// lost.
fn several(part: &DevicesPart, server: &RunningServer, probes: &Probes) -> Result<Vec<Finding>> {
    let engines = server.engines();
    let devices = engines.len();
    let lights = server.lights();
    let shape = MaskShape::new(1280, 720, lights)?;
    // Three sessions per device keep its ring full, directly at the engine so that only the devices are measured.
    let rate = |of: &[Engine]| -> Result<f64> {
        let masks: u64 = std::thread::scope(|scope| {
            let busy: Vec<_> = of
                .iter()
                .flat_map(|engine| [engine, engine, engine])
                .map(|engine| {
                    scope.spawn(move || {
                        let mut port = engine.open_session(shape)?;
                        let (begun, mut masks) = (Instant::now(), 0);
                        while begun.elapsed() < Duration::from_secs(part.seconds.into()) {
                            request(&mut port, shape, masks);
                            let traced = port.masks.blocking_recv().context("the engine has ended")?;
                            port.recycle(traced.mask);
                            masks += 1;
                        }
                        Ok::<u64, anyhow::Error>(masks.into())
                    })
                })
                .collect();
            let joined = busy.into_iter().map(|busy| busy.join().unwrap_or_else(|_| bail!("a thread panicked")));
            joined.sum::<Result<u64>>()
        })?;
        #[expect(clippy::cast_precision_loss, reason = "some thousands of masks")]
        Ok(masks as f64 / f64::from(part.seconds))
    };
    let (one, all) = (rate(&engines[..1])?, rate(engines)?);
    let sessions = || engines.iter().map(Engine::sessions).collect::<Vec<_>>();
    let (spread, moved) = std::thread::scope(|scope| {
        let count = u32::try_from(devices * 3).unwrap_or(6);
        let ask = Ask { size: (320, 180), fps: Some(20.0), frames: 200 };
        let running = (0..count)
            .map(|number| {
                std::thread::sleep(Duration::from_millis(50));
                probes.spawn(scope, ask, number)
            })
            .collect::<Result<Vec<_>>>()?;
        std::thread::sleep(Duration::from_secs(3));
        let spread = sessions();
        engines[0].inject(Fault::DeviceLost);
        std::thread::sleep(Duration::from_secs(1));
        let moved = sessions();
        let whole = running.into_iter().map(joined).filter(Result::is_ok).count();
        Ok::<_, anyhow::Error>(((spread, count), (moved, whole)))
    })?;
    let ((spread, count), (moved, whole)) = (spread, moved);
    Ok(vec![
        Finding::new(
            &format!(
                "{devices} devices trace at least {:.1} times as much as one",
                0.9 * f64::from(u32::try_from(devices)?)
            ),
            format!("{one:.0} masks/s of 1280×720 on one, {all:.0} on all: {:.2} times", all / one),
            all >= one * 0.9 * f64::from(u32::try_from(devices)?),
        ),
        Finding::new(
            "sessions are placed on all devices",
            format!("{count} sessions: {spread:?}"),
            spread.iter().all(|sessions| *sessions > 0),
        ),
        Finding::new(
            "the sessions of a lost device move to the others",
            format!("after the loss {moved:?}; {whole} of {count} sessions lived to their end"),
            moved[0] == 0 && moved.iter().sum::<usize>() == count as usize && whole == count as usize,
        ),
    ])
}

fn request(port: &mut SessionPort, shape: MaskShape, frame: u32) {
    let target = glam::DVec3::new(0.3, 0.1, 1.0);
    port.request(TraceRequest {
        frame: FrameNumber(frame),
        camera: Camera::looking_at(glam::DVec3::ZERO, target, 1.0, shape.width(), shape.height()),
        scene: SceneAt::default(),
        ahead: None,
        received_at: Instant::now(),
        interval: Duration::from_millis(16),
    });
}

/// Waits for at most [`PATIENCE`].
fn await_mask(port: &mut SessionPort) -> Result<()> {
    let begun = Instant::now();
    while port.masks.try_recv().is_err() {
        ensure!(begun.elapsed() < PATIENCE, "no mask within {} s", PATIENCE.as_secs());
        std::thread::sleep(Duration::from_micros(200));
    }
    Ok(())
}
