//! Promise: `lab link` stands between a real server and a real client, and says where to connect and what it did.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use std::path::Path;

use gnomon_lab::{
    cloister::asset,
    rig::{ClientJob, PATIENCE, ServerProcess, program::Program},
};

#[test]
fn the_standalone_link_says_where_to_connect_and_what_it_did() {
    let server = ServerProcess::start(&asset("cloister.glb"), &["--backend", "cpu"]).unwrap();
    let arguments = ["link", "--server", server.url(), "--profile", "lan", "--both", "loss=1%", "--seed", "3"];
    let mut lab = Program::start(Path::new(env!("CARGO_BIN_EXE_lab")), &arguments, &[]).unwrap();
    let url = lab
        .wait_for(PATIENCE, |said| {
            let whole = said.get(..said.rfind('\n')? + 1)?;
            whole.lines().find(|line| line.starts_with("gnomon://")).map(str::to_owned)
        })
        .unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = format!("{}#walk", asset("cloister.json").display());
    let arguments = ["--fps", "30", "--allow-software"].map(Into::into).to_vec();
    let job = ClientJob {
        url: Some(&url),
        path: path.into(),
        frames: 30,
        size: (160, 90),
        folder: folder.path(),
        save_masks: false,
        arguments,
    };
    job.start().unwrap().finish(PATIENCE).unwrap().success().unwrap();
    let id = lab.id().to_string();
    assert!(std::process::Command::new("kill").args(["-INT", &id]).status().unwrap().success());
    let outcome = lab.finish(PATIENCE).unwrap().success().unwrap();
    let lines: Vec<&str> = outcome.stdout.lines().collect();
    assert_eq!(lines[0], "lan, seed 3");
    assert_eq!(lines[1], "up:   delay=0.2ms loss=1% rate=1000000kbit queue=512000B");
    assert!(lines[5].starts_with("down: ") && lines[5].contains(" arrived, "), "{}", outcome.stdout);
    assert!(!lines[5].contains(" 0 arrived"), "{}", outcome.stdout);
}
