//! Promise: over QUIC and lab-udp, the real server and client work through a network that loses, reorders, repeats and
//! corrupts datagrams, and survive an outage.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use std::{net::SocketAddr, path::Path};

use gnomon_client::camera_path::PathSpec;
use gnomon_lab::{
    cloister::asset,
    link::{self, Counts, LinkCounts, LinkSettings, profiles::Profile},
    rig::{ClientJob, PATIENCE, ServerProcess, masks},
};
use gnomon_protocol::mask::{Mask, MaskShape};
use gnomon_scene::{LoadOptions, Scene};
use gnomon_server::visibility::backend::cpu::CpuBackend;
use serde_json::Value;

const SIZE: (u32, u32) = (160, 90);
const FREE: &str = "127.0.0.1:0";

fn path_text() -> String {
    format!("{}#walk", asset("cloister.json").display())
}

struct Run {
    summary: Value,
    stats: Vec<Value>,
    masks: std::collections::BTreeMap<u32, Mask>,
    counts: LinkCounts,
}

fn job<'a>(url: &'a str, folder: &'a Path, frames: u32) -> ClientJob<'a> {
    ClientJob {
        url: Some(url),
        path: path_text().into(),
        frames,
        size: SIZE,
        folder,
        save_masks: true,
        // Whole masks, one per file, and only poses on the way up.
        arguments: ["--fps", "30", "--allow-software", "--codec", "planes-lz4"].map(Into::into).to_vec(),
    }
}

fn run(transport: &str, settings: LinkSettings, frames: u32) -> Run {
    // Masks of the requested poses, so that they can be checked; pictures that cost little.
    run_with(transport, settings, frames, &["--predict-pose=false", "--predict", "none", "--quality", "low"])
}

fn run_with(transport: &str, settings: LinkSettings, frames: u32, more: &[&str]) -> Run {
    let arguments = ["--backend", "cpu", "--transport", transport];
    let server = ServerProcess::start(&asset("cloister.glb"), &arguments).unwrap();
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let free: SocketAddr = FREE.parse().unwrap();
    let link = runtime.block_on(link::server::start(free, server.url(), settings)).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let url = link.url(server.url()).unwrap();
    assert_ne!(url, server.url());
    let mut job = job(&url, folder.path(), frames);
    job.arguments.extend(more.iter().map(Into::into));
    job.start().unwrap().finish(PATIENCE).unwrap().success().unwrap();
    let counts = link.counts();
    for direction in [counts.up, counts.down] {
        let Counts { arrived, delivered, lost, burst_lost, queue_dropped, too_large, outage, overrun, .. } = direction;
        let dropped = lost + burst_lost + queue_dropped + too_large + outage;
        assert_eq!(arrived, delivered + dropped, "{counts:?}");
        assert_eq!(overrun, 0, "{counts:?}");
    }
    let (summary, stats) = (job.summary().unwrap(), job.stats().unwrap());
    assert_eq!((summary["frames_rendered"].as_u64(), stats.len()), (Some(frames.into()), frames as usize), "{summary}");
    server.stop().unwrap();
    Run { summary, stats, masks: masks::read(&folder.path().join("masks")).unwrap(), counts }
}

/// Worse than wifi. Bits are flipped only if the transport detects it: lab-udp has no checksum but the kernel's.
fn lossy(corrupt: &str) -> LinkSettings {
    let mut settings = Profile::named("wifi").unwrap().settings(5).unwrap();
    for direction in [&mut settings.up, &mut settings.down] {
        direction.set(&format!("loss=2% burst=1%x4 reorder=1% duplicate=2% corrupt={corrupt}")).unwrap();
    }
    settings
}

fn cloister() -> Scene {
    Scene::load(&asset("cloister.glb"), &LoadOptions::default()).unwrap()
}

fn traced(backend: &CpuBackend, lights: u32, frame: u32) -> Mask {
    let path = path_text().parse::<PathSpec>().unwrap().load().unwrap();
    let mut camera = path.camera(f64::from(frame) * (1.0 / 30.0), SIZE.0, SIZE.1);
    // The server normalises received orientations.
    camera.orientation = camera.orientation.normalize();
    let mut mask = Mask::new(MaskShape::new(SIZE.0, SIZE.1, lights).unwrap());
    let _cost = backend.trace(&camera, &mut mask);
    mask
}

fn masks_are_right(run: &Run) {
    let backend = CpuBackend::new(&cloister(), None).unwrap();
    for (&frame, mask) in run.masks.iter().step_by(1 + run.masks.len() / 8) {
        assert_eq!(traced(&backend, mask.shape().lights(), frame).words(), mask.words(), "frame {frame}");
    }
}

#[test]
fn quic_delivers_right_masks_through_loss_and_corruption() {
    let run = run("quic", lossy("0.5%"), 240);
    let down = run.counts.down;
    assert!(down.lost > 0 && down.burst_lost > 0 && down.duplicated > 0 && down.reordered > 0, "{down:?}");
    assert!(down.corrupted > 0, "{down:?}");
    assert!(run.masks.len() >= 10, "{}", run.summary);
    // A frame that lost packets is incomplete.
    assert!(run.summary["frames_incomplete"].as_u64().unwrap() > 0, "{}", run.summary);
    assert_eq!(run.summary["frames_bad"], 0, "{}", run.summary);
    masks_are_right(&run);
}

/// The smallest path that QUIC works on (RFC 9000, §14: datagrams of 1200 bytes), 800 ms there and back.
#[test]
fn a_far_and_narrow_path_carries_everything() {
    let mut settings = LinkSettings::default();
    for direction in [&mut settings.up, &mut settings.down] {
        direction.set("delay=400ms mtu=1228B").unwrap();
    }
    let run = run("quic", settings, 150);
    for direction in [run.counts.up, run.counts.down] {
        assert_eq!((direction.too_large, direction.lost), (0, 0), "{:?}", run.counts);
    }
    assert!(run.masks.len() >= 10, "{}", run.summary);
    masks_are_right(&run);
}

#[test]
fn lab_udp_and_its_data_port_go_through_the_link() {
    let run = run("lab-udp", lossy("0%"), 240);
    let counts = run.counts;
    // At most one pose per frame goes up: a newer one replaces an unsent one. Each mask answers a pose that arrived.
    assert!(counts.up.arrived <= 240, "{counts:?}");
    assert!(run.masks.len() as u64 <= counts.up.delivered, "{counts:?}");
    assert!(counts.up.lost + counts.up.burst_lost > 0, "{counts:?}");
    assert!(counts.down.arrived > 0 && run.masks.len() >= 10, "{counts:?} {}", run.summary);
    assert!(run.masks.len() as u64 <= counts.down.delivered, "{counts:?}");
    masks_are_right(&run);
}

#[test]
fn sessions_outlive_an_outage() {
    for transport in ["quic", "lab-udp"] {
        let mut settings = LinkSettings::default();
        settings.up.set("outage=2s+3s").unwrap();
        settings.down.set("outage=2s+3s").unwrap();
        // Enough frames after the outage for a reconnecting client, which may need three seconds.
        let run = run(transport, settings, 360);
        assert!(run.counts.up.outage > 0, "{transport}: {:?}", run.counts);
        let lags: Vec<u64> = run.stats.iter().filter_map(|line| line["lag"].as_u64()).collect();
        let (longest, last) = (*lags.iter().max().unwrap(), *lags.last().unwrap());
        let after = lags.iter().rposition(|lag| *lag == longest).unwrap();
        assert!(lags[after..].iter().any(|lag| *lag < 30), "{transport}: no masks after the outage: {lags:?}");
        if transport == "lab-udp" {
            // Each frame's pose is one datagram: the lag grew by all that were lost, and shrank again.
            assert!(longest + 2 >= run.counts.up.outage && last < longest, "{longest} {last} {:?}", run.counts);
        }
    }
}

#[test]
fn an_extrapolating_server_reports_the_traced_pose() {
    let mut settings = LinkSettings::default();
    settings.up.set("delay=80ms").unwrap();
    settings.down.set("delay=80ms").unwrap();
    let run = run_with("quic", settings, 90, &["--mode", "concurrent", "--predict-pose=true"]);
    let last = run.stats.last().unwrap();
    assert!((160..1000).contains(&last["look_ahead_ms"].as_u64().unwrap()), "{last}");
    // The client predicts from the masks' own views: otherwise almost no pixel would be known.
    assert!(last["lag"].as_u64().unwrap() > 0 && last["known_share"].as_f64().unwrap() > 0.5, "{last}");
    // The masks are not those of the poses that were sent.
    let backend = CpuBackend::new(&cloister(), None).unwrap();
    let late: Vec<_> = run.masks.iter().filter(|&(&frame, _)| frame >= 30).step_by(4).collect();
    let moved = late
        .iter()
        .filter(|&&(&frame, mask)| traced(&backend, mask.shape().lights(), frame).words() != mask.words())
        .count();
    assert!(late.len() >= 3 && moved * 2 > late.len(), "{moved} of {}", late.len());
}
