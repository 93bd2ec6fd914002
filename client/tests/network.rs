//! Runs that do not wait, against a scripted server that goes silent, leaves, or sends unrequested masks.

#![expect(
    clippy::unwrap_used,
    clippy::panic,
    reason = "clippy knows tests by their functions, and the stage has others"
)]

mod stage;

use std::path::Path;

use gnomon_client::{HeadlessOptions, Summary, mode::Mode, run_headless};
use gnomon_protocol::{ids::ResumeToken, message::ServerMessage};
use serde_json::Value;
use stage::{Script, Stage, mask_for};

/// Largest age of predicted masks, and fade, in seconds: so short that an outage of a second shows every state.
const PREDICTION_LAG_S: f64 = 10.0 / 60.0;
const FADE_S: f64 = 0.1;

fn options(stage: &Stage, folder: &Path, frames: u32) -> HeadlessOptions {
    let mut options = stage.options(folder);
    (options.settings.frames, options.settings.fps) = (Some(frames), Some(60.0));
    options.settings.prediction_lag = PREDICTION_LAG_S;
    options.settings.fade = FADE_S;
    options.settings.stats = Some(folder.join("stats.jsonl"));
    options
}

fn run(options: &HeadlessOptions) -> (Summary, Vec<Value>) {
    let summary = run_headless(options).unwrap();
    let stats = std::fs::read_to_string(options.settings.stats.as_ref().unwrap()).unwrap();
    (summary, stats.lines().map(|line| serde_json::from_str(line).unwrap()).collect())
}

/// Asserts that the visibility share never changes faster than the fade allows.
fn assert_no_pop(lines: &[Value]) {
    for pair in lines.windows(2) {
        let number = |line: &Value, name| line[name].as_f64().unwrap();
        let step = (number(&pair[1], "visibility_share") - number(&pair[0], "visibility_share")).abs();
        let allowed = (number(&pair[1], "t_ms") - number(&pair[0], "t_ms")) * 1e-3 / FADE_S;
        assert!(step <= allowed + 1e-3, "{step} > {allowed}: {pair:?}");
    }
}

#[test]
fn an_outage_fades_out_and_back_in() {
    for mode in [Mode::Auto, Mode::Concurrent, Mode::Sequential] {
        let lose = (90..150).map(|frame| (frame, None)).collect();
        let stage = Stage::start("lab-udp", Script { lose, ..Script::default() });
        let folder = tempfile::tempdir().unwrap();
        let mut options = options(&stage, folder.path(), 240);
        options.settings.mode = mode;
        let (summary, lines) = run(&options);
        assert_eq!((summary.frames_rendered, lines.len()), (240, 240), "no frame is missing");
        assert_eq!(summary.connection_lost, None);
        assert_no_pop(&lines);
        let share = |line: &Value| line["visibility_share"].as_f64().unwrap();
        let before = lines[..90].iter().rev().find(|line| line["lag"].as_u64().is_some()).unwrap();
        assert_eq!(share(before), 1.0, "{before}");
        assert!(lines.iter().any(|line| line["state"] == "degraded" && share(line) == 0.0), "it was not seen");
        let first = lines.iter().position(|line| line["mask_frame"].as_u64() >= Some(150)).unwrap();
        assert!(lines[first]["state"] != "degraded" && share(&lines[first + 1]) > 0.0, "{}", lines[first]);
        assert_eq!(share(&lines[239]), 1.0);
        let degraded = lines.iter().filter(|line| line["state"] == "degraded").count();
        assert!((summary.degraded_share.unwrap() - degraded as f64 / 240.0).abs() < 1e-9);
        for line in lines.iter().filter(|line| line["lag"].as_u64().is_some()) {
            let late = line["lag"].as_u64() > Some(2) && line["age_ms"].as_f64() > Some(PREDICTION_LAG_S * 1e3);
            assert_eq!(line["state"] == "degraded", late, "{line}");
        }
    }
}

#[test]
fn a_run_continues_after_its_server_leaves() {
    let stage = Stage::start("lab-tcp", Script { close_at: Some(30), gone: true, ..Script::default() });
    let folder = tempfile::tempdir().unwrap();
    // Long enough for a server that is slow to see frame 30.
    let (summary, lines) = run(&options(&stage, folder.path(), 240));
    assert_eq!((summary.frames_rendered, lines.len(), summary.reconnects), (240, 240, 0));
    assert_eq!(lines[239]["link"], "lost");
    assert!(summary.connection_lost.unwrap().contains("curtain"));
    assert!(summary.lost_at_end.is_some());
    assert_no_pop(&lines);
    let last = lines.last().unwrap();
    assert_eq!((&last["state"], last["visibility_share"].as_f64()), (&"degraded".into(), Some(0.0)));

    let answer = ServerMessage::Closing { reason: "no play today".into(), may_return: true };
    let stage = Stage::start("lab-tcp", Script { answer: Some(answer), ..Script::default() });
    let folder = tempfile::tempdir().unwrap();
    run_headless(&options(&stage, folder.path(), 10)).unwrap_err();
}

#[test]
fn a_returning_server_is_found_and_resumed() {
    let stage = Stage::start("lab-tcp", Script { close_at: Some(30), ..Script::default() });
    let folder = tempfile::tempdir().unwrap();
    // Long enough for a second attempt on a busy machine.
    let (summary, lines) = run(&options(&stage, folder.path(), 300));
    assert_eq!((summary.frames_rendered, lines.len(), summary.reconnects), (300, 300, 1));
    assert_eq!(summary.lost_at_end, None);
    assert!(summary.connection_lost.unwrap().contains("curtain"));
    assert_eq!(summary.masks_rejected.before_reconnect, 0);
    assert_no_pop(&lines);
    let last = lines.last().unwrap();
    assert_eq!(
        (&last["state"], &last["link"], last["visibility_share"].as_f64()),
        (&"concurrent".into(), &"live".into(), Some(1.0))
    );
    assert!(last["mask_frame"].as_u64() > Some(30), "{last}");
    assert_eq!(stage.resumed()[..2], [None, Some(ResumeToken([7; 16]))]);
    assert_eq!(stage.scene_fetches(), [0], "the scene is cached");
}

#[test]
fn a_client_that_was_sent_away_stays_away() {
    let stage = Stage::start("lab-tcp", Script { close_at: Some(30), dismissed: true, ..Script::default() });
    let folder = tempfile::tempdir().unwrap();
    let (summary, lines) = run(&options(&stage, folder.path(), 240));
    assert_eq!((summary.frames_rendered, lines.len(), summary.reconnects), (240, 240, 0));
    assert!(summary.lost_at_end.unwrap().contains("curtain"));
    assert_eq!(lines[239]["link"], "lost");
    assert_eq!(stage.resumed(), [None]);
}

#[test]
fn a_server_cannot_make_its_clients_read_their_files() {
    let cert = "00".repeat(32);
    for url in [
        "gnomon+lab-tcp://127.0.0.1:9/?ca=/dev/zero".to_owned(),
        "gnomon://127.0.0.1:9/?ca=/dev/zero".to_owned(),
        format!("gnomon://127.0.0.1:9/?cert={cert}&ca=/dev/zero"),
        format!("gnomon://127.0.0.1:9/?cert={cert}"),
        "gnomon+lab-tcp://192.0.2.1:9".to_owned(),
        "file:///dev/zero\x1b[2J\n".to_owned(),
    ] {
        let stage = Stage::start("lab-tcp", Script { drain_at: Some((5, url.clone())), ..Script::default() });
        let folder = tempfile::tempdir().unwrap();
        let (summary, lines) = run(&options(&stage, folder.path(), 40));
        assert_eq!((summary.frames_rendered, summary.reconnects, summary.connection_lost), (40, 0, None), "{url}");
        // The notice itself arrived.
        assert_eq!(lines[39]["link"], "draining", "{url}");
        assert_eq!(stage.resumed().len(), 1, "{url}");
    }
}

#[test]
fn a_draining_server_sends_its_clients_elsewhere() {
    let elsewhere = Stage::start("lab-tcp", Script::default());
    let script = Script { drain_at: Some((20, elsewhere.url())), ..Script::default() };
    let stage = Stage::start("lab-tcp", script);
    let folder = tempfile::tempdir().unwrap();
    let (summary, lines) = run(&options(&stage, folder.path(), 300));
    assert_eq!((summary.frames_rendered, summary.reconnects, summary.connection_lost), (300, 1, None));
    assert_eq!(elsewhere.resumed(), [None], "the resume token goes to no other server");
    assert!(
        lines.iter().all(|line| line["link"] == "live" || line["link"] == "draining"),
        "no frame was without a server"
    );
    assert!(lines.last().unwrap()["mask_frame"].as_u64() > Some(200), "{:?}", lines.last());
    assert!(stage.received_bye());
}

#[test]
fn a_still_camera_requests_rarely_and_is_no_outage() {
    let stage = Stage::start("lab-tcp", Script::default());
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("still.json");
    let still = r#"{"camera_path": {"keyframes": [{"t": 0, "pos": [0, 1, 1], "target": [0, 0, 0]}]}}"#;
    std::fs::write(&path, still).unwrap();
    let mut options = options(&stage, folder.path(), 150);
    options.settings.path = Some(path.to_str().unwrap().parse().unwrap());
    let (summary, lines) = run(&options);
    // 2.5 s: some requests until the first mask, then one a second.
    assert!(summary.frames_received < 75, "{}", summary.frames_received);
    assert_eq!(summary.lag_frames_p50, Some(0.0));
    let settled = &lines[100..];
    assert!(settled.iter().all(|line| line["state"] == "concurrent" && line["lag"] == 0), "{settled:?}");
}

#[test]
fn unrequested_masks_are_counted_and_ignored() {
    // A frame number that is not sent for a while yet, then masks that are too small: several, since a newer mask takes
    // the place of one that a busy machine has not looked at.
    let small = 40..60;
    let script = Script { strays: vec![(20, 100)], smaller: small.clone().collect(), ..Script::default() };
    let stage = Stage::start("lab-udp", script);
    let folder = tempfile::tempdir().unwrap();
    let (summary, lines) = run(&options(&stage, folder.path(), 120));
    assert_eq!((summary.frames_rendered, summary.frames_bad), (120, 0));
    let rejected = summary.masks_rejected;
    assert_eq!(rejected.future, 1, "{rejected:?}");
    assert!((1..=small.len() as u64).contains(&rejected.wrong_size), "{rejected:?}");
    assert!(lines.iter().all(|line| line["mask_frame"].as_u64() <= line["frame"].as_u64()));
    let drawn = lines.iter().filter_map(|line| u32::try_from(line["mask_frame"].as_u64()?).ok());
    assert!(drawn.filter(|frame| small.contains(frame)).count() == 0, "{lines:?}");
    assert!(lines.last().unwrap()["mask_frame"].as_u64() > Some(80), "{:?}", lines.last());
}

#[test]
fn a_mask_from_the_far_future_does_not_block_later_masks() {
    let stage = Stage::start("lab-udp", Script { strays: vec![(20, 1_000_000)], ..Script::default() });
    let folder = tempfile::tempdir().unwrap();
    let (summary, lines) = run(&options(&stage, folder.path(), 120));
    assert_eq!(summary.masks_rejected.future, 1);
    assert!(lines.last().unwrap()["mask_frame"].as_u64() > Some(60), "{:?}", lines.last());
}

#[test]
fn a_waiting_run_rejects_masks_of_another_size() {
    let stage = Stage::start("lab-udp", Script { smaller: vec![1], ..Script::default() });
    let folder = tempfile::tempdir().unwrap();
    let mut options = stage.options(folder.path());
    options.settings.wait = true;
    options.settings.stats = Some(folder.path().join("stats.jsonl"));
    options.settings.save_masks = Some(folder.path().join("masks"));
    let (summary, lines) = run(&options);
    assert_eq!((summary.frames_with_mask, summary.masks_rejected.wrong_size), (4, 1));
    assert!(lines.iter().all(|line| line["mask_frame"] == line["frame"]), "{lines:?}");
    let saved = std::fs::read(folder.path().join("masks/frame_000001.body")).unwrap();
    let mut mask = gnomon_protocol::mask::Mask::new(stage::shape());
    gnomon_protocol::codec::Decoder::new().decode(&saved, &mut mask).unwrap();
    assert_eq!(mask, mask_for(1));
}
