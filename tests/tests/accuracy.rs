//! Promise: what a client receives is right. On real scenes, through a real server and a real client, at most 0.01 % of
//! the relevant bits differ from what the f64 referee is sure of, none of them farther than a pixel from an edge of the
//! truth, on the `cpu` back end and on `compute`.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use std::path::Path;

use gnomon_lab::{
    metrics::RelevantError,
    reference::{Reference, Truth},
    rig::{ClientJob, PATIENCE, ServerProcess, masks},
    scenes::real::{JUDGED, RealScene, Stop},
};
use gnomon_protocol::mask::Mask;
use gnomon_scene::{LoadOptions, Scene};

const SIZE: (u32, u32) = (640, 360);
/// At most this share of the relevant bits may differ though the referee is sure of them.
const MOST_WRONG: f64 = 0.0001;
/// Undecided bits stand apart, so they must be few: at most this share.
const MOST_UNDECIDED: f64 = 0.002;
/// `compute` runs on whatever adapter there is, software Vulkan at worst.
const COMPUTE: [&str; 3] = ["--backend", "compute", "--allow-software"];

/// The masks of one stop, as a client received and kept them: one a frame, all from the same place.
fn received(server: &ServerProcess, stop: &Stop) -> Mask {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("path.json");
    std::fs::write(&path, stop.path_json().to_string()).unwrap();
    let job = ClientJob {
        url: Some(server.url()),
        path: path.into(),
        frames: 2,
        size: SIZE,
        folder: folder.path(),
        wait: true,
        save_masks: true,
        arguments: vec!["--allow-software".into()],
    };
    job.start().unwrap().finish(PATIENCE).unwrap().success().unwrap();
    let mut masks = masks::read(&folder.path().join("masks")).unwrap();
    assert_eq!(masks.keys().copied().collect::<Vec<_>>(), [0, 1], "the frames that --wait shades with their own masks");
    let last = masks.remove(&1).unwrap();
    assert_eq!(masks[&0], last, "two masks from one place differ");
    last
}

fn judge(scene: &RealScene, backend: &str, place: usize, mask: &Mask, truth: &Truth) {
    let error = RelevantError::of(mask, truth);
    println!("{} at stop {place}, {backend}: {error}", scene.name);
    let surfaces = truth.pixels.iter().filter(|verdict| verdict.surface).count();
    assert!(surfaces * 2 > truth.pixels.len(), "only {surfaces} pixels see a surface: the camera is misplaced");
    assert!(error.relevant > 100_000, "only {} relevant bits", error.relevant);
    assert!(error.sure_share() <= MOST_WRONG, "{} at stop {place}, {backend}: {:?}", scene.name, error.examples);
    assert!(error.worst_distance_px <= 1.0, "{} at stop {place}, {backend}: {:?}", scene.name, error.examples);
    assert!(error.undecided as f64 <= MOST_UNDECIDED * error.relevant as f64, "{} undecided", error.undecided);
    assert_eq!(error.irrelevant_set, 0, "{} at stop {place}, {backend} sets bits where nothing matters", scene.name);
}

fn judge_scene(name: &str) {
    let scene = JUDGED.iter().find(|scene| scene.name == name).unwrap();
    let (path, json) = (scene.path().unwrap(), scene.json().unwrap());
    let lights_from = scene.lights_from_json.then_some(&json);
    let options = LoadOptions { lights_from: lights_from.cloned(), ..LoadOptions::default() };
    let reference = Reference::new(&Scene::load(&path, &options).unwrap());
    let stops = scene.stops().unwrap();
    let truths: Vec<_> = stops.iter().map(|stop| reference.trace(&stop.camera(SIZE.0, SIZE.1))).collect();
    drop(reference);
    let serve = |backend: &[&str]| {
        let mut arguments = backend.to_vec();
        if let Some(json) = lights_from.and_then(|json: &std::path::PathBuf| Path::to_str(json)) {
            arguments.extend(["--lights-from", json]);
        }
        ServerProcess::start(&path, &arguments).unwrap()
    };
    let server = serve(&["--backend", "cpu"]);
    for (place, (stop, truth)) in stops.iter().zip(&truths).enumerate() {
        judge(scene, "cpu", place, &received(&server, stop), truth);
    }
    server.stop().unwrap();
    let server = serve(&COMPUTE);
    judge(scene, "compute", 0, &received(&server, &stops[0]), &truths[0]);
    server.stop().unwrap();
}

#[test]
fn sponza() {
    judge_scene("sponza");
}

#[test]
fn modern_hall() {
    judge_scene("modern-hall");
}

#[test]
fn grey_white_room() {
    judge_scene("grey-white-room");
}

#[test]
fn pink_room_partial() {
    judge_scene("pink-room-partial");
}

#[test]
fn breakfast_room() {
    judge_scene("breakfast-room");
}

#[test]
fn sponza_dabrovic() {
    judge_scene("sponza-dabrovic");
}
