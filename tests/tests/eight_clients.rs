//! Promise: eight clients at once each get their own correct frames. Killing three of them does not affect the others,
//! and their sessions end within the idle timeout.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use std::{
    fs,
    path::Path,
    time::{Duration, Instant},
};

use glam::DVec3;
use gnomon_client::camera_path::{CameraPath, PathSpec};
use gnomon_lab::{
    rig::{ClientJob, PATIENCE, masks, program::Program},
    scenes::real::{JUDGED, stop},
};
use gnomon_protocol::mask::{Mask, MaskShape};
use gnomon_scene::{LoadOptions, Scene, camera::Camera};
use gnomon_server::{
    RunningServer, Server,
    config::{Backend, ServerConfig},
    visibility::backend::cpu::CpuBackend,
};
use serde_json::json;
use tempfile::TempDir;

const CLIENTS: usize = 8;
const KILLED: usize = 3;
/// Small pictures and many frames: this tests sessions, not speed.
const SIZE: (u32, u32) = (96, 54);
/// Twelve seconds: the first client must still run when the last one starts.
const FRAMES: u32 = 240;
/// Survivors must still run when the sessions of the killed expire.
const FPS: u32 = 20;
const IDLE: Duration = Duration::from_secs(1);
/// Allowance beyond the idle timeout: eight clients share two cores.
const SLACK: Duration = Duration::from_secs(20);

/// Writes a path for one client: beside the scene's, with another view.
fn write_path(json: &Path, client: usize, file: &Path) {
    let aside = client as f64 * 0.02;
    let keyframe = |t: f64, at: f64| {
        let stop = stop(json, None, at).unwrap();
        let target = stop.target_m + DVec3::new(0.0, aside * 5.0, 0.0);
        let position = stop.position_m + DVec3::new(0.0, aside, 0.0);
        json!({ "t": t, "pos": position.to_array(), "target": target.to_array() })
    };
    let keyframes = json!([keyframe(0.0, aside * 10.0), keyframe(f64::from(FRAMES / FPS), 2.0 + aside * 10.0)]);
    let path = json!({ "yfov_deg": 60.0, "camera_path": { "keyframes": keyframes } });
    fs::write(file, path.to_string()).unwrap();
}

struct Client {
    folder: TempDir,
    program: Program,
}

impl Client {
    fn start(url: &str, json: &Path, number: usize) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("path.json");
        write_path(json, number, &path);
        let program = Self::job(folder.path(), Some(url)).start().unwrap();
        Self { folder, program }
    }

    fn job<'a>(folder: &'a Path, url: Option<&'a str>) -> ClientJob<'a> {
        ClientJob {
            url,
            path: folder.join("path.json").into(),
            frames: FRAMES,
            size: SIZE,
            folder,
            save_masks: true,
            // The masks are judged, so the pictures may cost little.
            arguments: ["--wait", "--predict", "none", "--quality", "low", "--fps", &FPS.to_string()]
                .map(Into::into)
                .to_vec(),
        }
    }

    fn received(&self) -> usize {
        fs::read_dir(self.folder.path().join("masks")).map_or(0, Iterator::count)
    }

    /// Waits for its end and returns its masks with their cameras.
    fn results(self) -> Vec<(Camera, Mask)> {
        self.program.finish(PATIENCE).unwrap().success().unwrap();
        let job = Self::job(self.folder.path(), None);
        let summary = job.summary().unwrap();
        assert_eq!(summary["frames_rendered"], FRAMES, "{summary}");
        assert_eq!(summary["frames_incomplete"], 0, "{summary}");
        let mut masks = masks::read(&self.folder.path().join("masks")).unwrap();
        assert_eq!(masks.len(), FRAMES as usize);
        let stats = job.stats().unwrap();
        assert_eq!(stats.len(), FRAMES as usize);
        let spec: PathSpec = self.folder.path().join("path.json").to_str().unwrap().parse().unwrap();
        let path = spec.load().unwrap();
        let frames = (0..FRAMES).zip(&stats).map(|(frame, line)| {
            assert_eq!(
                (&line["frame"], &line["mask_frame"]),
                (&json!(frame), &json!(frame)),
                "not its own mask: {line}"
            );
            (camera_of(&path, frame), masks.remove(&frame).unwrap())
        });
        frames.collect()
    }
}

/// Returns the camera of a frame as the server gets it.
fn camera_of(path: &CameraPath, frame: u32) -> Camera {
    let mut camera = path.camera(f64::from(frame) * (1.0 / f64::from(FPS)), SIZE.0, SIZE.1);
    // The server normalises received orientations.
    camera.orientation = camera.orientation.normalize();
    camera
}

fn wait_until(what: &str, patience: Duration, mut done: impl FnMut() -> bool) -> Duration {
    let start = Instant::now();
    while !done() {
        assert!(start.elapsed() < patience, "still not after {patience:?}: {what}");
        std::thread::sleep(Duration::from_millis(5));
    }
    start.elapsed()
}

#[test]
fn eight_clients_are_served_and_killing_three_leaves_the_others_served() {
    let scene = JUDGED.iter().find(|scene| scene.name == "modern-hall").unwrap();
    let (path, json) = (scene.path().unwrap(), scene.json().unwrap());
    let certificate = tempfile::tempdir().unwrap();
    let config = ServerConfig {
        scene: Some(path.clone()),
        listen: "127.0.0.1:0".parse().unwrap(),
        backend: Backend::Cpu,
        cert_dir: Some(certificate.path().into()),
        idle_timeout_ms: u64::try_from(IDLE.as_millis()).unwrap(),
        // All are admitted, however long their first masks take beside other programs.
        device_budget_ms: 100_000,
        cores_budget_ms: Some(100_000),
        ..ServerConfig::default()
    };
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let server: RunningServer = runtime.block_on(Server::start(config)).unwrap();
    let url = server.url();

    let mut clients: Vec<_> = (0..CLIENTS).map(|number| Client::start(&url, &json, number)).collect();
    wait_until("eight sessions with frames", PATIENCE, || {
        for client in &mut clients {
            assert!(client.program.is_running().unwrap(), "a client ended too early: {:?}", client.program.said());
        }
        clients.iter().all(|client| client.received() >= 3)
    });
    assert_eq!(server.sessions(), CLIENTS);

    let survivors = clients.split_off(KILLED);
    for client in clients {
        let received = client.received();
        assert!(received < FRAMES as usize, "killed after its end, which proves nothing");
        client.program.kill().unwrap();
    }
    let mut survivors = survivors;
    survivors.iter_mut().for_each(|client| assert!(client.program.is_running().unwrap(), "over before the killing"));
    let gone = wait_until("three sessions gone", IDLE + SLACK, || {
        // A finished survivor has closed its session, so only running ones may have one.
        let running =
            survivors.iter_mut().map(|client| usize::from(client.program.is_running().unwrap())).sum::<usize>();
        server.sessions() <= running
    });
    println!("the sessions of the killed were gone after {gone:?}; the idle timeout is {IDLE:?}");

    let backend = CpuBackend::new(&Scene::load(&path, &LoadOptions::default()).unwrap(), None).unwrap();
    let mut all_frames = Vec::new();
    for (number, client) in survivors.into_iter().enumerate() {
        let frames = client.results();
        for (frame, (camera, mask)) in frames.iter().enumerate() {
            let mut expected = Mask::new(MaskShape::new(SIZE.0, SIZE.1, mask.shape().lights()).unwrap());
            let _cost = backend.trace(camera, &mut expected);
            assert_eq!(expected.words(), mask.words(), "survivor {number}, frame {frame}");
        }
        all_frames.push(frames.into_iter().map(|(_, mask)| mask).collect::<Vec<_>>());
    }
    // Paths must differ, or the check would pass with the same frames for everybody.
    for (number, frames) in all_frames.iter().enumerate() {
        assert_ne!(frames.first(), frames.last(), "survivor {number} stood still");
        for other in &all_frames[..number] {
            assert_ne!(frames[0], other[0], "two paths begin alike");
        }
    }
    wait_until("no session left", IDLE + SLACK, || server.sessions() == 0);
    runtime.block_on(server.shutdown());
}
