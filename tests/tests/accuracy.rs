//! Promise: received masks are right. On real scenes, through a real server and client, at most 0.01 % of the relevant
//! bits differ where the f64 referee is certain, and none is farther than a pixel from an edge of the truth, with the
//! `cpu` and `compute` back ends.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

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
/// Most bits, as a share of the relevant ones, that may differ where the referee is certain.
const MOST_WRONG: f64 = 0.0001;
/// Most undecided bits, as a share of the relevant ones: they excuse errors, so they must be few.
const MOST_UNDECIDED: f64 = 0.002;
/// `compute` runs on any adapter, software Vulkan included.
const COMPUTE: [&str; 3] = ["--backend", "compute", "--allow-software"];

/// Returns the mask of one stop as a client received it; two frames from the same place must agree.
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
        save_masks: true,
        // The masks are judged, so the pictures may cost little.
        arguments: ["--wait", "--allow-software", "--predict", "none", "--quality", "low"].map(Into::into).to_vec(),
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

macro_rules! judge {
    ($($scene:ident)*) => {$(
        #[test]
        fn $scene() {
            judge_scene(&stringify!($scene).replace('_', "-"));
        }
    )*};
}

judge!(sponza modern_hall grey_white_room pink_room_partial breakfast_room sponza_dabrovic);
