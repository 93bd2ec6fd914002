//! Promise: what a client changes in a scene is in its next picture and in the masks that answer it, bit by bit as if
//! the file had it; a world of its own outlives a lost connection; and in a shared world all see the same states.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use std::{
    ffi::OsString,
    fmt::Write as _,
    fs,
    net::SocketAddr,
    path::{Path, PathBuf},
    sync::Arc,
    time::{Duration, Instant},
};

use gnomon_client::{
    camera_path::PathSpec,
    record::{Record, replay::Records},
};
use gnomon_lab::{
    link::{self, LinkSettings},
    rig::{ClientJob, PATIENCE, ServerProcess, masks},
};
use gnomon_protocol::{
    codec::Decoder,
    mask::{Mask, MaskShape},
};
use gnomon_scene::{
    Edit, Edits, LightEdit, LoadOptions, NodeEdit, Scene, SceneAt, camera::Camera, testing::write_living_scene,
};
use gnomon_server::visibility::backend::cpu::CpuBackend;
use serde_json::{Value, json};

const SIZE: (u32, u32) = (160, 90);
const FREE: &str = "127.0.0.1:0";

/// The square and the lamp that travels, by their numbers in the file.
const EDITABLE: &str = "1,3";

/// Numbers among the nodes that may be edited.
const SQUARE: u32 = 0;
const LAMP: u32 = 1;

/// Writes a path of four seconds and returns its file.
fn write_path(folder: &Path) -> PathBuf {
    let key = |t: f64, x: f64| json!({"t": t, "pos": [x, 2.5, 5.0], "target": [0.0, 0.5, 0.0]});
    let path = json!({"camera_path": {"keyframes": [key(0.0, -1.0), key(4.0, 1.5)]}});
    let file = folder.join("path.json");
    fs::write(&file, path.to_string()).unwrap();
    file
}

/// The scene, in which nothing moves by itself.
fn editable(file: &Path) -> Scene {
    let editable = EDITABLE.split(',').map(str::to_owned).collect();
    Scene::load(file, &LoadOptions { editable, ..LoadOptions::default() }).unwrap()
}

fn server(file: &Path, more: &[&str]) -> ServerProcess {
    ServerProcess::start(file, &[&["--backend", "cpu", "--editable", EDITABLE], more].concat()).unwrap()
}

fn job<'a>(url: &'a str, path: &Path, folder: &'a Path, frames: u32, more: &[&str]) -> ClientJob<'a> {
    fs::create_dir_all(folder).unwrap();
    let fixed = ["--allow-software", "--exposure", "3", "--environment", "none", "--codec", "planes-lz4"];
    let arguments: Vec<OsString> = fixed.iter().chain(more).map(Into::into).collect();
    ClientJob { url: Some(url), path: path.into(), frames, size: SIZE, folder, save_masks: false, arguments }
}

/// The bytes of a folder's pictures.
fn pictures(folder: &Path) -> Vec<Vec<u8>> {
    let mut files: Vec<_> = fs::read_dir(folder.join("pictures")).unwrap().map(|file| file.unwrap().path()).collect();
    files.sort();
    files.iter().map(|file| fs::read(file).unwrap()).collect()
}

#[test]
fn pictures_and_masks_are_those_of_the_edited_scene() {
    let folder = tempfile::tempdir().unwrap();
    let file = write_living_scene(folder.path()).unwrap();
    let (scene, path) = (editable(&file), write_path(folder.path()));
    let moved = NodeEdit {
        translation_m: Some(glam::DVec3::new(0.5, 1.0, 0.25)),
        rotation: Some(glam::DQuat::from_array([0.0, 0.6, 0.0, 0.8])),
        scale: Some(glam::DVec3::new(2.0, 1.0, -1.5)),
        shown: None,
    };
    let lower = NodeEdit { translation_m: Some(glam::DVec3::new(-1.0, 2.0, 0.5)), ..NodeEdit::default() };
    let dark = LightEdit { intensity: Some(0.0), ..LightEdit::default() };
    let lines = [
        json!({"t": 0, "node": SQUARE, "translation": [0.5, 1.0, 0.25], "rotation": [0.0, 0.6, 0.0, 0.8],
            "scale": [2.0, 1.0, -1.5]}),
        json!({"t": 1, "node": LAMP, "translation": [-1.0, 2.0, 0.5]}),
        json!({"t": 2, "light": 0, "intensity": 0}),
        json!({"t": 3, "light": 0}),
        json!({"t": 3, "node": SQUARE, "shown": false}),
    ];
    let hidden = NodeEdit { shown: Some(false), ..NodeEdit::default() };
    let changes = [
        vec![Edit::Node(SQUARE, moved)],
        vec![Edit::Node(LAMP, lower)],
        vec![Edit::Light(0, dark)],
        vec![Edit::Light(0, LightEdit::default()), Edit::Node(SQUARE, hidden)],
        vec![],
    ];
    let script = folder.path().join("edits.jsonl");
    fs::write(&script, lines.map(|line| line.to_string()).join("\n")).unwrap();
    let own = folder.path().join("own");
    let out = own.join("pictures");
    let more = ["--wait", "--edits", script.to_str().unwrap(), "--out", out.to_str().unwrap()];
    let server = server(&file, &[]);
    let edited = ClientJob { save_masks: true, ..job(server.url(), &path, &own, 5, &more) };
    edited.start().unwrap().finish(PATIENCE).unwrap().success().unwrap();
    assert_eq!(edited.summary().unwrap()["edits_refused"], 0);
    server.stop().unwrap();
    let camera_path = path.display().to_string().parse::<PathSpec>().unwrap().load().unwrap();
    let (tracer, masks, shown) =
        (CpuBackend::new(&scene, None).unwrap(), masks::read(&own.join("masks")).unwrap(), pictures(&own));
    assert_eq!((masks.len(), shown.len()), (5, 5));
    let mut edits = Edits::default();
    for ((frame, mask), changed) in masks.iter().zip(changes) {
        changed.into_iter().for_each(|edit| edits.apply(edit).unwrap());
        let at = SceneAt { time_s: 0.0, edits: Arc::new(edits.clone()) };
        let time_s = f64::from(*frame);
        let mut expected = Mask::new(mask.shape());
        tracer.trace_at(&camera_path.camera(time_s, SIZE.0, SIZE.1), &at, &mut expected);
        assert!(*mask == expected, "the mask of frame {frame}");
        // The scene that stands so, with a server of its own.
        let (still, stands) = (folder.path().join(format!("{frame}.scene")), folder.path().join(format!("{frame}")));
        fs::write(&still, scene.still_at(&at).pack().unwrap()).unwrap();
        let server = ServerProcess::start(&still, &["--backend", "cpu"]).unwrap();
        let (start, out) = (format!("--start-time={time_s}"), stands.join("pictures"));
        let more = ["--wait", &start, "--out", out.to_str().unwrap()];
        job(server.url(), &path, &stands, 1, &more).start().unwrap().finish(PATIENCE).unwrap().success().unwrap();
        server.stop().unwrap();
        assert!(shown[*frame as usize] == pictures(&stands)[0], "the picture of frame {frame}");
    }
    assert!(shown.windows(2).all(|pair| pair[0] != pair[1]), "nothing changes");
}

/// A mask's state and camera, and the mask if it came whole.
type Traced = (Edits, Camera, Option<Mask>);

/// What a recording has: its masks, and the states of its pictures.
fn recorded(file: &Path) -> (Vec<Traced>, Vec<Edits>) {
    let (_, mut records) = Records::open(file).unwrap();
    let (mut traced, mut drawn, mut decoder) = (Vec::new(), Vec::new(), Decoder::new());
    while let Some(record) = records.next().unwrap() {
        match record {
            Record::Mask { traced_for, edits, body, coverage, .. } => {
                let camera = Camera::from(&traced_for);
                let mut mask = Mask::new(MaskShape::new(camera.width, camera.height, 2).unwrap());
                decoder.decode(&body, &mut mask).unwrap();
                traced.push((edits, camera, coverage.is_none().then_some(mask)));
            }
            Record::Frame { edits, .. } => drawn.push(edits),
            _ => {}
        }
    }
    (traced, drawn)
}

fn lamp_x(edits: &Edits) -> Option<f64> {
    edits.node(LAMP).translation_m.map(|there| there.x)
}

#[test]
fn two_clients_of_a_shared_world_see_a_dragged_lamp_alike() {
    let folder = tempfile::tempdir().unwrap();
    let file = write_living_scene(folder.path()).unwrap();
    let (scene, path) = (editable(&file), write_path(folder.path()));
    // A hundred places a second, for three seconds.
    let mut script = String::new();
    for step in 0..300_u32 {
        let x = f64::from(step) * 0.01 - 1.5;
        let line = json!({"t": f64::from(step) * 0.01, "node": LAMP, "translation": [x, 3.0, 0.0]});
        writeln!(script, "{line}").unwrap();
    }
    let last_x = 299.0 * 0.01 - 1.5;
    let drag = folder.path().join("drag.jsonl");
    fs::write(&drag, script).unwrap();
    let server = server(&file, &["--shared-world"]);
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let mut settings = LinkSettings::default();
    for direction in [&mut settings.up, &mut settings.down] {
        direction.set("delay=30ms loss=2%").unwrap();
    }
    let (free, folder) = (FREE.parse::<SocketAddr>().unwrap(), folder.path());
    let lossy = |name: &'static str, frames: u32, more: &[&str]| {
        let link = runtime.block_on(link::server::start(free, server.url(), settings.clone())).unwrap();
        let (own, url) = (folder.join(name), link.url(server.url()).unwrap());
        let record = own.join("recording");
        let fixed = ["--fps", "20", "--predict-pose=false", "--guard", "0x0", "--record", record.to_str().unwrap()];
        let running = job(&url, &path, &own, frames, &[&fixed[..], more].concat()).start().unwrap();
        (link, running, record)
    };
    // It is there before anything moves, and longer.
    let watching = lossy("watching", 100_000, &[]);
    let seen = || fs::read_to_string(folder.join("watching/stats.jsonl")).unwrap_or_default().lines().count();
    let waits = Instant::now();
    while seen() < 2 {
        assert!(waits.elapsed() < PATIENCE, "the watching client does not draw");
        std::thread::sleep(Duration::from_millis(20));
    }
    let mut recordings = Vec::new();
    let dragging = lossy("dragging", 120, &["--edits", drag.to_str().unwrap()]);
    dragging.1.finish(PATIENCE).unwrap().success().unwrap();
    recordings.push(recorded(&dragging.2));
    // Some pictures later it has heard all.
    let heard = seen() + 100;
    while seen() < heard {
        assert!(waits.elapsed() < 2 * PATIENCE, "the watching client has stopped");
        std::thread::sleep(Duration::from_millis(20));
    }
    watching.1.terminate().unwrap();
    watching.1.finish(PATIENCE).unwrap();
    recordings.push(recorded(&watching.2));
    let late = lossy("late", 20, &[]);
    late.1.finish(PATIENCE).unwrap().success().unwrap();
    recordings.push(recorded(&late.2));
    server.stop().unwrap();

    let tracer = CpuBackend::new(&scene, None).unwrap();
    let mut states = Vec::new();
    for (traced, drawn) in &recordings {
        assert_eq!(drawn.last().and_then(lamp_x), Some(last_x), "where the lamp was left");
        let mut whole = 0;
        for (edits, camera, mask) in traced {
            let Some(mask) = mask else { continue };
            let mut expected = Mask::new(mask.shape());
            tracer.trace_at(camera, SceneAt { time_s: 0.0, edits: Arc::new(edits.clone()) }, &mut expected);
            assert!(*mask == expected, "a mask is that of its state");
            whole += 1;
        }
        assert!(whole > 0, "no mask came whole");
        states.push(traced.iter().filter_map(|(edits, ..)| lamp_x(edits)).collect::<Vec<f64>>());
    }
    // Who comes later knows it from the first mask on.
    assert!(states[2].iter().all(|x| *x == last_x), "{:?}", states[2]);
    // Lamps move one way, and both have seen it move.
    for seen in &states[..2] {
        assert!(seen.is_sorted() && seen.first() < seen.last(), "{seen:?}");
    }
}

/// Waits for a line of a running client's statistics.
fn wait_for<T>(folder: &Path, wanted: impl Fn(&Value) -> Option<T>) -> T {
    let begun = Instant::now();
    loop {
        let text = fs::read_to_string(folder.join("stats.jsonl")).unwrap_or_default();
        // The last line may not be whole.
        let last = text.rfind('\n').and_then(|end| text[..end].lines().last().map(str::to_owned));
        let last = last.map(|line| serde_json::from_str::<Value>(&line).unwrap());
        if let Some(found) = last.as_ref().and_then(&wanted) {
            return found;
        }
        assert!(begun.elapsed() < PATIENCE, "{last:?}");
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// The number of the frame, if it shows a mask of a frame after `since`.
fn served_since(since: u64) -> impl Fn(&Value) -> Option<u64> {
    move |frame| (frame["link"] == "live" && frame["mask_frame"].as_u64() > Some(since)).then(|| number(frame))
}

/// The number of the frame, if its client has no server.
fn lost(frame: &Value) -> Option<u64> {
    (frame["link"] != "live" && frame["link"] != "draining").then(|| number(frame))
}

fn number(frame: &Value) -> u64 {
    frame["frame"].as_u64().unwrap()
}

/// Masks are those of the states that they name. Returns where the lamp was in each.
fn lamps_of(scene: &Scene, traced: &[Traced]) -> Vec<Option<f64>> {
    let tracer = CpuBackend::new(scene, None).unwrap();
    let mut lamps = Vec::new();
    for (edits, camera, mask) in traced {
        let Some(mask) = mask else { continue };
        let mut expected = Mask::new(mask.shape());
        tracer.trace_at(camera, SceneAt { time_s: 0.0, edits: Arc::new(edits.clone()) }, &mut expected);
        assert!(*mask == expected, "a mask is that of its state");
        lamps.push(lamp_x(edits));
    }
    lamps
}

const ENDLESS: u32 = 1_000_000;

#[test]
fn a_world_of_its_own_outlives_its_server() {
    let folder = tempfile::tempdir().unwrap();
    let file = write_living_scene(folder.path()).unwrap();
    let (scene, path, own) = (editable(&file), write_path(folder.path()), folder.path().join("own"));
    let (certificate, script, record) =
        (folder.path().join("certificate"), folder.path().join("edits.jsonl"), own.join("recording"));
    fs::write(&script, json!({"t": 0, "node": LAMP, "translation": [-1.0, 2.0, 0.5]}).to_string()).unwrap();
    let serve = |listen: &str| server(&file, &["--listen", listen, "--cert-dir", certificate.to_str().unwrap()]);
    let first = serve(FREE);
    let url = first.url().to_owned();
    let more = ["--fps", "20", "--edits", script.to_str().unwrap(), "--record", record.to_str().unwrap()];
    let job = job(&url, &path, &own, ENDLESS, &more);
    let client = job.start().unwrap();
    wait_for(&own, served_since(0));
    first.kill().unwrap();
    let since = wait_for(&own, lost);
    let second = serve(url.split_once("://").unwrap().1.split('/').next().unwrap());
    wait_for(&own, served_since(since));
    client.terminate().unwrap();
    client.finish(PATIENCE).unwrap();
    second.stop().unwrap();
    let summary = job.summary().unwrap();
    assert_eq!((&summary["reconnects"], &summary["edits_refused"]), (&1.into(), &0.into()));
    // The second server knows the lamp's place from the client alone.
    let lamps = lamps_of(&scene, &recorded(&record).0);
    assert_eq!(lamps.last(), Some(&Some(-1.0)), "{lamps:?}");
}

#[test]
fn who_returns_to_a_shared_world_finds_what_others_have_changed() {
    let folder = tempfile::tempdir().unwrap();
    let file = write_living_scene(folder.path()).unwrap();
    let (scene, path, own) = (editable(&file), write_path(folder.path()), folder.path().join("own"));
    let (script, record) = (folder.path().join("edits.jsonl"), own.join("recording"));
    fs::write(&script, json!({"t": 0, "node": LAMP, "translation": [-1.0, 2.0, 0.5]}).to_string()).unwrap();
    let server = server(&file, &["--shared-world"]);
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let relay = |listen: SocketAddr| {
        runtime.block_on(link::server::start(listen, server.url(), LinkSettings::default())).unwrap()
    };
    let first = relay(FREE.parse().unwrap());
    let (address, url) = (first.address(), first.url(server.url()).unwrap());
    let job_of = job(&url, &path, &own, ENDLESS, &["--fps", "20", "--record", record.to_str().unwrap()]);
    let client = job_of.start().unwrap();
    wait_for(&own, served_since(0));
    // The network is gone, but the server is not. A connection outlives ten seconds of silence at most.
    drop(first);
    let gone = Instant::now() + Duration::from_secs(12);
    let since = wait_for(&own, lost);
    let other = folder.path().join("other");
    let edits = ["--wait", "--edits", script.to_str().unwrap()];
    job(server.url(), &path, &other, 5, &edits).start().unwrap().finish(PATIENCE).unwrap().success().unwrap();
    std::thread::sleep(gone.saturating_duration_since(Instant::now()));
    let _second = relay(address);
    wait_for(&own, served_since(since));
    client.terminate().unwrap();
    client.finish(PATIENCE).unwrap();
    server.stop().unwrap();
    assert_eq!(job_of.summary().unwrap()["reconnects"], 1);
    let lamps = lamps_of(&scene, &recorded(&record).0);
    assert_eq!((lamps.first(), lamps.last()), (Some(&None), Some(&Some(-1.0))), "{lamps:?}");
}
