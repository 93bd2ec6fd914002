//! Promise: sessions survive jumps of the wall clock by hours in both directions. Tokens, with their sessions, and
//! certificates expire by the clock, and no time in the log is negative.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

mod walk;

use std::{fs, net::Ipv4Addr, path::Path, time::Duration};

use gnomon_client::{
    ClientError,
    app::probe::{ProbeOptions, ProbeReport, run_probe},
};
use gnomon_lab::rig::Ask;
use gnomon_server::{
    RunningServer, Server,
    clock::step,
    config::{Backend, LogFormat, ServerConfig},
    logs,
    tokens::{self, Scope},
};
use serde_json::Value;
use tokio::runtime::Runtime;

const HOUR_S: i64 = 3600;
const DAY_S: i64 = 24 * HOUR_S;

fn start(runtime: &Runtime, folder: &Path, tokens: &str) -> RunningServer {
    fs::write(folder.join("tokens.toml"), tokens).unwrap();
    let config = ServerConfig {
        scene: Some(gnomon_scene::testing::write_scene(folder).unwrap()),
        listen: (Ipv4Addr::LOCALHOST, 0).into(),
        backend: Backend::Cpu,
        cert_dir: Some(folder.join("cert")),
        token_file: Some(folder.join("tokens.toml")),
        drain_ms: 0,
        ..ServerConfig::default()
    };
    runtime.block_on(Server::start(config)).unwrap()
}

#[test]
fn sessions_go_on_and_tokens_and_certificates_expire_by_the_clock() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("log");
    let logs = logs::init(LogFormat::Json, Some(&log)).unwrap();
    let runtime = Runtime::new().unwrap();
    let (for_a_day, day_entry) = tokens::make("day", Some(1), &[Scope::Session], false).unwrap();
    let (for_ever, ever_entry) = tokens::make("ever", None, &[Scope::Session], false).unwrap();
    let server = start(&runtime, folder.path(), &(day_entry + &ever_entry));
    let path = walk::path(folder.path());
    let run = |token: &str, frames: u32| -> Result<ProbeReport, ClientError> {
        let ask = Ask { size: (64, 36), fps: Some(20.0), frames };
        let options = ProbeOptions { token: Some(token.to_owned()), ..ask.of(&server.url().parse().unwrap()) };
        run_probe(runtime.handle(), &options, &path)
    };
    let refused = |token: &str| run(token, 1).unwrap_err().to_string();
    let browsers = server.browser_certificate_sha256().unwrap();
    std::thread::scope(|scope| {
        let long = scope.spawn(|| run(&for_ever, 160));
        let expiring = scope.spawn(|| run(&for_a_day, 1200));
        while server.sessions() < 2 {
            std::thread::sleep(Duration::from_millis(5));
        }
        // Forwards beyond the expiry of a token and of the browsers' certificate: a session whose token is still good
        // goes on.
        step::set(14 * DAY_S);
        let ended = expiring.join().unwrap().unwrap_err().to_string();
        assert!(ended.contains("its token expired"), "{ended}");
        assert!(refused(&for_a_day).contains("token"), "{}", refused(&for_a_day));
        assert_eq!(run(&for_ever, 5).unwrap().poses, 5);
        let renewed = server.browser_certificate_sha256().unwrap();
        assert_ne!(renewed, browsers);
        // Back before the start, when the renewed certificate is not valid yet.
        step::set(-6 * HOUR_S);
        assert_eq!(run(&for_a_day, 5).unwrap().poses, 5);
        assert_ne!(server.browser_certificate_sha256().unwrap(), renewed);
        let session = long.join().unwrap().unwrap();
        assert!(session.masks * 2 > u64::from(session.poses), "{} of {} masks", session.masks, session.poses);
    });
    step::set(0);
    runtime.block_on(server.shutdown());
    drop(logs);
    let text = fs::read_to_string(&log).unwrap();
    let mut ended = 0;
    for line in text.lines() {
        let entry: Value = serde_json::from_str(line).unwrap();
        for (name, value) in entry["fields"].as_object().unwrap() {
            assert!(value.as_f64().is_none_or(|value| value >= 0.0), "{name} in {line}");
        }
        if entry["fields"]["message"] == "session ended" {
            ended += 1;
            let seconds = entry["fields"]["seconds"].as_f64().unwrap();
            assert!(seconds < 3600.0, "it lasted as long as it did, whatever the clock said: {line}");
        }
    }
    assert_eq!(ended, 4, "{text}");
}
