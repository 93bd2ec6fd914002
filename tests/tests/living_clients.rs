//! Promise: a client shows a moving scene as it is at the frame's time, with the shadows of that time: masks are the
//! referee's, and a picture is that of the scene that stands still then, byte by byte.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use std::{
    ffi::OsString,
    fs,
    path::{Path, PathBuf},
};

use gnomon_client::camera_path::PathSpec;
use gnomon_lab::{
    metrics::RelevantError,
    reference::Reference,
    rig::{
        ClientJob, PATIENCE, ServerProcess, masks,
        program::{Program, find},
    },
};
use gnomon_scene::{LoadOptions, Scene, testing::write_living_scene};
use serde_json::json;

const SIZE: (u32, u32) = (160, 90);

/// As for still scenes (`accuracy.rs`).
const MOST_WRONG: f64 = 0.0001;

/// Writes a path of four seconds and returns its file.
fn write_path(folder: &Path) -> PathBuf {
    let key = |t: f64, x: f64| json!({"t": t, "pos": [x, 2.5, 5.0], "target": [0.0, 0.5, 0.0]});
    let path = json!({"camera_path": {"keyframes": [key(0.0, -1.0), key(4.0, 1.5)]}});
    let file = folder.join("path.json");
    fs::write(&file, path.to_string()).unwrap();
    file
}

fn moving(file: &Path) -> Scene {
    Scene::load(file, &LoadOptions { animation: Some("all".to_owned()), ..LoadOptions::default() }).unwrap()
}

/// Draws frames that wait for their masks, from a time on, into `folder`. Each is a tenth of a second after the last
/// unless they are spread over the path.
fn draw(server: &ServerProcess, path: &Path, folder: &Path, frames: u32, start_s: f64) {
    fs::create_dir_all(folder).unwrap();
    let pictures = folder.join("pictures");
    let start = format!("--start-time={start_s}");
    // Light around is that of the time at which a run begins.
    let fixed = ["--exposure", "3", "--environment", "none", "--codec", "planes-lz4"];
    let mut arguments: Vec<OsString> = ["--wait", "--allow-software", "--out"].map(Into::into).to_vec();
    arguments.extend([pictures.into_os_string(), start.into()]);
    arguments.extend(fixed.map(OsString::from));
    let url = Some(server.url());
    let job = ClientJob { url, path: path.into(), frames, size: SIZE, folder, save_masks: true, arguments };
    job.start().unwrap().finish(PATIENCE).unwrap().success().unwrap();
}

/// The bytes of a folder's only picture.
fn picture(folder: &Path, number: u32) -> Vec<u8> {
    let mut files: Vec<_> = fs::read_dir(folder.join("pictures")).unwrap().map(|file| file.unwrap().path()).collect();
    files.sort();
    fs::read(&files[number as usize]).unwrap()
}

#[test]
fn pictures_and_masks_are_those_of_their_times() {
    let folder = tempfile::tempdir().unwrap();
    let file = write_living_scene(folder.path()).unwrap();
    let (scene, path) = (moving(&file), write_path(folder.path()));
    let camera_path = path.display().to_string().parse::<PathSpec>().unwrap().load().unwrap();
    let server = ServerProcess::start(&file, &["--backend", "cpu", "--animation", "all"]).unwrap();
    let living = folder.path().join("living");
    draw(&server, &path, &living, 5, 0.0);
    server.stop().unwrap();
    let masks = masks::read(&living.join("masks")).unwrap();
    assert_eq!(masks.len(), 5);
    let mut pictures: Vec<Vec<u8>> = Vec::new();
    for (frame, mask) in masks {
        let time_s = f64::from(frame);
        let camera = camera_path.camera(time_s, SIZE.0, SIZE.1);
        let error = RelevantError::of(&mask, &Reference::at(&scene, time_s).trace(&camera));
        assert!(error.relevant > 10_000 && error.sure_share() <= MOST_WRONG, "{time_s} s: {error}");
        // The scene that stands still then, with a server of its own.
        let (still, stands) = (folder.path().join(format!("{frame}.scene")), folder.path().join(format!("{frame}")));
        fs::write(&still, scene.still_at(time_s).pack().unwrap()).unwrap();
        let server = ServerProcess::start(&still, &["--backend", "cpu"]).unwrap();
        draw(&server, &path, &stands, 1, time_s);
        server.stop().unwrap();
        pictures.push(picture(&living, frame));
        assert!(pictures.last() == Some(&picture(&stands, 0)), "the picture at {time_s} s");
    }
    assert!(pictures.windows(2).all(|pair| pair[0] != pair[1]), "nothing moves");
}

#[test]
fn a_camera_of_the_file_takes_the_client_along() {
    let folder = tempfile::tempdir().unwrap();
    let file = write_living_scene(folder.path()).unwrap();
    let scene = moving(&file);
    let server = ServerProcess::start(&file, &["--backend", "cpu", "--animation", "all"]).unwrap();
    // The path ends where it begins, so times go on by the clock of frames.
    draw(&server, Path::new("scene#eye"), folder.path(), 4, 1.0);
    server.stop().unwrap();
    for (frame, mask) in masks::read(&folder.path().join("masks")).unwrap() {
        let time_s = 1.0 + f64::from(frame) / 30.0;
        let camera = &scene.cameras_at(time_s)[0];
        let camera = gnomon_scene::camera::Camera {
            position_m: camera.position_m,
            orientation: camera.orientation,
            yfov_rad: camera.yfov_rad,
            width: SIZE.0,
            height: SIZE.1,
        };
        let error = RelevantError::of(&mask, &Reference::at(&scene, time_s).trace(&camera));
        assert!(error.relevant > 10_000 && error.sure_share() <= MOST_WRONG, "{time_s} s: {error}");
    }
    assert_ne!(picture(folder.path(), 0), picture(folder.path(), 3));
}

#[test]
fn both_programs_name_the_animations_that_there_are() {
    let folder = tempfile::tempdir().unwrap();
    let file = write_living_scene(folder.path()).unwrap().into_os_string();
    let certificate = folder.path().join("certificate").into_os_string();
    let fails = |name: &str, arguments: &[OsString]| {
        let program = Program::start(&find(name).unwrap(), arguments, &[("RUST_LOG", "off")]).unwrap();
        let outcome = program.finish(PATIENCE).unwrap();
        assert!(!outcome.status.success() && outcome.stderr.lines().count() == 1, "{outcome:?}");
        for animation in ["dance", "slide", "travel", "rise"] {
            assert!(outcome.stderr.contains(animation), "{name}: {}", outcome.stderr);
        }
    };
    let words = |words: &[&str]| words.iter().map(OsString::from).collect::<Vec<_>>();
    let unknown = words(&["--animation", "dance"]);
    let listen = words(&["--listen", "127.0.0.1:0", "--backend", "cpu", "--cert-dir"]);
    fails(
        "gnomon-server",
        &[&words(&["--scene"])[..], std::slice::from_ref(&file), &listen, &[certificate], &unknown].concat(),
    );
    fails("gnomon-client", &[&words(&["--headless", "--allow-software", "--offline"])[..], &[file], &unknown].concat());
}
