//! Promise: a client whose server comes back with another scene goes on there. One that can no longer be served says
//! what a person has to do, and its exit code tells.
#![cfg(target_os = "linux")]
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

mod display;
mod leaver;

use std::{fs, time::Instant};

use display::Display;
use gnomon_client::record::{Record, replay::Records};
use gnomon_lab::{
    cloister::asset,
    rig::{
        PATIENCE,
        program::{Program, find},
    },
};
use gnomon_server::tokens::{self, Scope};
use leaver::{Stage, address_of, complaint, serve, signal, text, watch};
use serde_json::Value;

const ENDLESS: u32 = 1_000_000;

/// Returns the number of the last frame if a mask of it or a later frame than `since` is shown.
fn served_since(since: u64) -> impl Fn(&[Value]) -> Option<u64> {
    move |lines| {
        let last = lines.last()?;
        (last["link"] == "live" && last["mask_frame"].as_u64() > Some(since)).then(|| last["frame"].as_u64().unwrap())
    }
}

/// Returns the number of the last frame once the server is lost.
fn lost(lines: &[Value]) -> Option<u64> {
    lines.last().filter(|last| last["link"] != "live" && last["link"] != "draining")?["frame"].as_u64()
}

#[test]
fn a_client_follows_its_server_to_other_scenes() {
    let (stage, certificate) = (Stage::new(), tempfile::tempdir().unwrap());
    let (mut server, url) = serve(&stage.scene, "127.0.0.1:0", certificate.path(), &[]);
    let (stats, summary, recording) = (stage.file("stats"), stage.file("summary"), stage.file("recording"));
    let files = ["--stats", text(&stats), "--summary", text(&summary), "--record", text(&recording)];
    let mut client = stage.client(&url, ENDLESS, &files, "warn");
    let mut since = watch(&mut client, &stats, served_since(0));
    // Another scene with other bounds, the same with other lights, and the first one again.
    let cloister = asset("cloister.glb");
    for (scene, lights) in [(&cloister, "6"), (&cloister, "1"), (&stage.scene, "2")] {
        server.kill().unwrap();
        since = watch(&mut client, &stats, |lines| lost(lines).filter(|frame| *frame > since));
        server = serve(scene, address_of(&url), certificate.path(), &["--lights", lights]).0;
        since = watch(&mut client, &stats, served_since(since));
    }
    client.wait_for(PATIENCE, |said| said.contains("the server has another scene: fetching it").then_some(())).unwrap();
    signal(&client, "TERM");
    let outcome = client.finish(PATIENCE).unwrap();
    assert_eq!(outcome.status.code(), Some(143), "{}", outcome.stderr);
    assert!(!outcome.stderr.contains("panicked"), "{}", outcome.stderr);
    let summary: Value = serde_json::from_slice(&fs::read(&summary).unwrap()).unwrap();
    assert_eq!((&summary["reconnects"], &summary["lights"]), (&3.into(), &2.into()));
    assert_eq!(summary["lost_at_end"], Value::Null);
    server.wait_for(PATIENCE, |said| said.contains("the client left").then_some(())).unwrap();

    // A recording has one scene.
    let (_, mut records) = Records::open(&recording).unwrap();
    let mut last = None;
    while let Some(record) = records.next().unwrap() {
        last = Some(record);
    }
    assert!(matches!(&last, Some(Record::Event { text, .. }) if text.contains("the recording ends here")), "{last:?}");
}

#[test]
fn a_window_follows_its_server_to_another_scene() {
    let (stage, certificate, display) = (Stage::new(), tempfile::tempdir().unwrap(), Display::start());
    let (server, url) = serve(&stage.scene, "127.0.0.1:0", certificate.path(), &[]);
    let (stats, folder) = (stage.file("stats"), stage.file("pictures"));
    fs::create_dir(&folder).unwrap();
    let environment = [("DISPLAY", display.name.as_str()), ("WAYLAND_DISPLAY", "")];
    let arguments = [&url, "--size", "160x90", "--allow-software", "--vsync=false", "--stats", text(&stats)];
    let all = [arguments.as_slice(), &["--out", text(&folder)]].concat();
    let mut client = Program::start(&find("gnomon-client").unwrap(), &all, &environment).unwrap();
    let since = watch(&mut client, &stats, served_since(0));
    server.kill().unwrap();
    let since = watch(&mut client, &stats, |lines| lost(lines).filter(|frame| *frame > since));
    let (mut server, _) = serve(&asset("cloister.glb"), address_of(&url), certificate.path(), &[]);
    watch(&mut client, &stats, served_since(since));
    // It still answers: a picture is saved, and Escape leaves.
    let id = display.person("search --sync --name Gnomon");
    display.focus(id.lines().next().unwrap());
    display.person("key p");
    let (picture, begun) = (folder.join("gnomon_00001.png"), Instant::now());
    while image::open(&picture).is_err() {
        assert!(begun.elapsed() < PATIENCE && client.is_running().unwrap(), "{:?}", client.said());
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
    display.person("key Escape");
    client.finish(PATIENCE).unwrap().success().unwrap();
    server.wait_for(PATIENCE, |said| said.contains("the client left").then_some(())).unwrap();
}

/// What ends a client's time with its server.
struct Loss {
    name: &'static str,
    /// The state in which it ends.
    link: &'static str,
    /// Words that tell a person what to do.
    words: &'static [&'static str],
}

#[test]
fn whoever_ends_without_a_server_says_why_and_fails() {
    let gone = Loss { name: "gone", link: "lost", words: &[] };
    let other = Loss { name: "certificate", link: "lost", words: &["another certificate", "use the URL"] };
    let token = Loss { name: "token", link: "refused", words: &["no longer takes this token", "get a new one"] };
    std::thread::scope(|scope| {
        let running: Vec<_> = [gone, other, token].map(|loss| scope.spawn(move || lose(&loss))).into();
        for ended in running {
            ended.join().unwrap();
        }
    });
}

/// Lets a client draw, takes its server away, and lets it come to its last frame.
fn lose(loss: &Loss) {
    const FRAMES: u32 = 800;
    let (stage, certificate, other) = (Stage::new(), tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let list = stage.file("tokens");
    let (ours, entry) = tokens::make("ours", None, &[Scope::Session], false).unwrap();
    fs::write(&list, entry).unwrap();
    let tokens = ["--token-file", text(&list)];
    let (server, url) = serve(&stage.scene, "127.0.0.1:0", certificate.path(), &tokens);
    let (stats, summary) = (stage.file("stats"), stage.file("summary"));
    let files = ["--stats", text(&stats), "--summary", text(&summary), "--token", &ours];
    let mut client = stage.client(&url, FRAMES, &files, "off");
    watch(&mut client, &stats, served_since(0));
    server.kill().unwrap();
    let _server = match loss.name {
        "gone" => None,
        "certificate" => Some(serve(&stage.scene, address_of(&url), other.path(), &tokens)),
        _ => {
            let (_, entry) = tokens::make("theirs", None, &[Scope::Session], false).unwrap();
            fs::write(&list, entry).unwrap();
            Some(serve(&stage.scene, address_of(&url), certificate.path(), &tokens))
        }
    };
    let outcome = client.finish(PATIENCE).unwrap();
    let line = complaint(&outcome.stderr);
    assert_eq!((outcome.status.code(), outcome.stderr.lines().count()), (Some(1), 1), "{}", outcome.stderr);
    assert!(line.starts_with("the run ended without its server: "), "{line}");
    assert!(loss.words.iter().all(|word| line.contains(word)), "{}: {line}", loss.name);
    // It has drawn on, and its files are whole.
    let summary: Value = serde_json::from_slice(&fs::read(&summary).unwrap()).unwrap();
    assert_eq!((&summary["frames_rendered"], &summary["reconnects"]), (&FRAMES.into(), &0.into()));
    assert!(line.contains(summary["lost_at_end"].as_str().unwrap()), "{line}");
    let lines = leaver::lines(&stats);
    assert_eq!((lines.len(), &lines.last().unwrap()["link"]), (FRAMES as usize, &loss.link.into()));
}
