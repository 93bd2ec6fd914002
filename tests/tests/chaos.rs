//! Promise: what `lab chaos` measures for minutes also holds in seconds: one session too many, faults of networks,
//! devices and sessions, and a server that stops. Rates and times depend on the machine's load and are not judged here.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use gnomon_lab::report::{chaos::run, scene_args::parse};

/// Runs a part. The returned function finds a promise by some of its words, and returns whether it is met and how.
fn chaos(part: &str, more: &str) -> impl Fn(&str) -> (bool, String) + use<> {
    let folder = tempfile::tempdir().unwrap();
    let scene = gnomon_scene::testing::write_scene(folder.path()).unwrap();
    let path = folder.path().join("lights_camera.json");
    let text = r#"{"camera_path": {"keyframes": [{"t": 0, "pos": [0, 2.5, 3], "target": [0, 0, 0]},
        {"t": 60, "pos": [3, 2.5, 0], "target": [0, 0, 0]}]}}"#;
    std::fs::write(path, text).unwrap();
    let line = format!("{part} --scene {} --out {}/out {more}", scene.display(), folder.path().display());
    let table = run(&parse(&line).unwrap(), |_| {}).unwrap();
    move |words| {
        let row = table.rows.iter().find(|row| row[0].contains(words)).unwrap_or_else(|| panic!("{words}: {table:?}"));
        (row[2] == "yes", row[1].clone())
    }
}

#[track_caller]
fn assert_met(found: impl Fn(&str) -> (bool, String), promises: &[&str]) {
    for promise in promises {
        let (met, measured) = found(promise);
        assert!(met, "{promise}: {measured}");
    }
}

#[test]
fn one_session_too_many_is_refused_and_the_others_are_not_cut_off() {
    let found = chaos("load", "--backend cpu --light 8 --heavy 1 --heavy-fps 5 --seconds 6");
    assert_met(found, &["one session too many", "nobody who was admitted"]);
}

#[test]
fn bad_networks_and_a_killed_server_end_no_session() {
    // At 30 % loss one of a few handshakes may fail; `lab chaos` judges many.
    let found = chaos("faults", "--backend cpu --handshakes 1 --rebindings 5 --black-holes 1");
    assert_met(&found, &["changes of the client's port", "black holes"]);
    let (_, measured) = found("after SIGKILL");
    assert!(measured.contains("480 of 480 frames drawn") && !measured.contains(" 0 reconnect"), "{measured}");
}

#[test]
fn panics_and_lost_devices_end_no_other_session() {
    for backend in ["cpu", "compute --allow-software --devices 2 --seconds 1"] {
        let found = chaos("devices", &format!("--panics 5 --losses 4 --backend {backend}"));
        assert_met(&found, &["panics in sessions' work", "a client's sessions outlive them"]);
        let (_, measured) = found("lost devices: serving again");
        assert!(measured.contains("4 masks came from new devices"), "{measured}");
    }
}

#[test]
fn a_stopping_server_sends_its_clients_to_another() {
    let found = chaos("drain", "--backend cpu --clients 2");
    assert_met(found, &["every client is told", "half sent", "nobody is admitted", "it exits with 0"]);
}

#[test]
fn clients_that_come_and_go_are_all_counted() {
    let found = chaos("soak", "--backend cpu --rate 4 --seconds 8");
    assert_met(found, &["every session is served and ends"]);
}
