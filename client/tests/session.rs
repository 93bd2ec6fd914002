//! Runs against a scripted server that sends and drops exactly what each test needs.

#![expect(
    clippy::unwrap_used,
    clippy::panic,
    reason = "clippy knows tests by their functions, and the stage has others"
)]

mod stage;

use std::{collections::BTreeMap, time::Duration};

use gnomon_client::{
    ClientError, run_headless, run_headless_until,
    stop::{Cause, Stop},
};
use gnomon_protocol::{
    codec::{CodecId, Decoder},
    mask::Mask,
    message::{Refusal, ServerMessage},
};
use stage::{Script, Stage, mask_for};

fn saved_masks(folder: &std::path::Path) -> BTreeMap<u32, Mask> {
    let read = |entry: std::io::Result<std::fs::DirEntry>| {
        let path = entry.unwrap().path();
        let name = path.file_stem().unwrap().to_str().unwrap().to_owned();
        let mut mask = Mask::new(stage::shape());
        Decoder::new().decode(&std::fs::read(path).unwrap(), &mut mask).unwrap();
        (name.strip_prefix("frame_").unwrap().parse().unwrap(), mask)
    };
    std::fs::read_dir(folder).unwrap().map(read).collect()
}

#[test]
fn a_waiting_run_shades_every_frame_with_its_own_mask() {
    for transport in ["lab-udp", "lab-tcp"] {
        let stage = Stage::start(transport, Script::default());
        let folder = tempfile::tempdir().unwrap();
        let mut options = stage.options(folder.path());
        options.settings.wait = true;
        options.settings.codec = CodecId::WordsLz4;
        options.settings.save_masks = Some(folder.path().join("masks"));
        options.settings.out = Some(folder.path().join("pictures"));
        options.settings.stats = Some(folder.path().join("stats.jsonl"));
        let summary = run_headless(&options).unwrap();
        assert_eq!((summary.frames_rendered, summary.frames_with_mask, summary.frames_received), (4, 4, 4));
        assert_eq!((summary.lag_frames_mean, summary.frames_incomplete), (Some(0.0), 0));
        assert_eq!((summary.transport.as_str(), summary.codec.as_deref()), (transport, Some("words-lz4")));
        assert_eq!(summary.scene_digest, Some(stage.digest().to_string()));
        assert!(summary.rtt_ms.is_some() && summary.payload_bytes_mean.unwrap() > 0.0);
        let expected: BTreeMap<u32, Mask> = (0..4).map(|frame| (frame, mask_for(frame))).collect();
        assert_eq!(saved_masks(&folder.path().join("masks")), expected);
        let stats = std::fs::read_to_string(folder.path().join("stats.jsonl")).unwrap();
        for (frame, line) in stats.lines().enumerate() {
            let line: serde_json::Value = serde_json::from_str(line).unwrap();
            assert_eq!((&line["frame"], &line["mask_frame"]), (&frame.into(), &frame.into()));
        }
        for frame in 0..4 {
            let picture = image::open(folder.path().join(format!("pictures/frame_{frame:06}.png"))).unwrap();
            assert_eq!((picture.width(), picture.height()), (64, 36));
        }
        assert!(stage.received_bye());
    }
}

#[test]
fn the_scene_is_fetched_once_then_read_from_the_cache() {
    let stage = Stage::start("lab-tcp", Script::default());
    let folder = tempfile::tempdir().unwrap();
    let options = stage.options(folder.path());
    run_headless(&options).unwrap();
    run_headless(&options).unwrap();
    assert_eq!(stage.scene_fetches(), [0]);
    // A damaged scene in the cache is fetched again.
    let cached = folder.path().join(format!("cache/{}.scene", stage.digest()));
    let mut bytes = std::fs::read(&cached).unwrap();
    bytes[40] ^= 0x20;
    std::fs::write(&cached, &bytes).unwrap();
    run_headless(&options).unwrap();
    assert_eq!(stage.scene_fetches(), [0, 0]);
    bytes[40] ^= 0x20;
    assert_eq!(std::fs::read(&cached).unwrap(), bytes);
    // A part left by an earlier run is not fetched again.
    std::fs::write(cached.with_extension("part"), &bytes[..100]).unwrap();
    std::fs::remove_file(&cached).unwrap();
    run_headless(&options).unwrap();
    assert_eq!(stage.scene_fetches(), [0, 0, 100]);
    // A client that was killed before it renamed its whole part leaves nothing to fetch, unless the part is damaged.
    std::fs::rename(&cached, cached.with_extension("part")).unwrap();
    run_headless(&options).unwrap();
    assert_eq!(stage.scene_fetches(), [0, 0, 100]);
    assert_eq!(std::fs::read(&cached).unwrap(), bytes);
    bytes[40] ^= 0x20;
    std::fs::write(cached.with_extension("part"), &bytes).unwrap();
    std::fs::remove_file(&cached).unwrap();
    run_headless(&options).unwrap();
    assert_eq!(stage.scene_fetches(), [0, 0, 100, 0]);
}

#[test]
fn a_lost_mask_is_requested_again() {
    // Frame 1 loses its second packet, frame 2 all packets, twice.
    let script = Script { lose: vec![(1, Some(1)), (2, None), (2, None)], ..Script::default() };
    let stage = Stage::start("lab-udp", script);
    let folder = tempfile::tempdir().unwrap();
    let mut options = stage.options(folder.path());
    options.settings.wait = true;
    options.settings.save_masks = Some(folder.path().join("masks"));
    let summary = run_headless(&options).unwrap();
    assert_eq!((summary.frames_rendered, summary.frames_with_mask, summary.frames_received), (4, 4, 4));
    assert_eq!((summary.frames_incomplete, summary.lag_frames_p99), (1, Some(0.0)));
    assert!(summary.poses_repeated >= 3, "{}", summary.poses_repeated);
    let expected: BTreeMap<u32, Mask> = (0..4).map(|frame| (frame, mask_for(frame))).collect();
    assert_eq!(saved_masks(&folder.path().join("masks")), expected);
}

#[test]
fn a_mask_received_twice_counts_once() {
    let stage = Stage::start("lab-tcp", Script { late: vec![2], ..Script::default() });
    let folder = tempfile::tempdir().unwrap();
    let mut options = stage.options(folder.path());
    options.settings.wait = true;
    let summary = run_headless(&options).unwrap();
    assert!(summary.poses_repeated >= 1, "{}", summary.poses_repeated);
    assert_eq!((summary.frames_with_mask, summary.frames_received, summary.frames_incomplete), (4, 4, 0));
}

#[test]
fn a_run_that_does_not_wait_goes_on_without_masks() {
    let lose = (0..200).map(|frame| (frame, None)).collect();
    let stage = Stage::start("lab-udp", Script { lose, ..Script::default() });
    let folder = tempfile::tempdir().unwrap();
    let summary = run_headless(&stage.options(folder.path())).unwrap();
    assert_eq!((summary.frames_rendered, summary.frames_with_mask, summary.frames_received), (4, 0, 0));
    assert_eq!((summary.lag_frames_mean, summary.payload_bytes_mean), (None, None));
}

#[test]
fn the_slices_that_arrive_are_shown() {
    for codec in [CodecId::TilesSmall, CodecId::TilesFast] {
        let lose = (0..400).map(|frame| (frame, Some(1))).collect();
        let stage = Stage::start("lab-udp", Script { lose, ..Script::default() });
        let folder = tempfile::tempdir().unwrap();
        let mut options = stage.options(folder.path());
        options.settings.codec = codec;
        options.settings.frames = Some(40);
        options.settings.fps = Some(60.0);
        options.settings.save_masks = Some(folder.path().join("masks"));
        let summary = run_headless(&options).unwrap();
        assert_eq!((summary.frames_received, summary.frames_bad, summary.frames_incomplete), (0, 0, 0), "{codec}");
        assert!(summary.frames_partial > 10 && summary.frames_with_mask > 10, "{codec}: {summary:?}");
        // Incomplete masks are not saved.
        assert_eq!(saved_masks(&folder.path().join("masks")), BTreeMap::new());
    }
}

/// The frame is first delivered without it: no frame waits for a packet longer than 25 ms.
#[test]
fn a_late_slice_is_still_decoded() {
    let script = Script { delayed: Some((1, Duration::from_millis(60))), ..Script::default() };
    let stage = Stage::start("lab-udp", script);
    let folder = tempfile::tempdir().unwrap();
    let mut options = stage.options(folder.path());
    (options.settings.codec, options.settings.frames, options.settings.fps) =
        (CodecId::TilesSmall, Some(12), Some(4.0));
    let summary = run_headless(&options).unwrap();
    assert_eq!((summary.frames_bad, summary.frames_incomplete), (0, 0));
    // The last one may not have arrived yet.
    assert!(summary.frames_received >= 8 && summary.frames_partial <= 1, "{summary:?}");
    // Complete masks are acknowledged, even after they were shown in part.
    assert!(stage.referenced() >= 6, "{} frames with references", stage.referenced());
}

#[test]
fn masks_are_decoded_against_the_right_references_only() {
    let pictures = |codec: CodecId, script: Script, save: bool| {
        let stage = Stage::start("lab-udp", script);
        let folder = tempfile::tempdir().unwrap();
        let mut options = stage.options(folder.path());
        (options.settings.wait, options.settings.codec, options.settings.frames) = (true, codec, Some(8));
        options.settings.out = Some(folder.path().join("pictures"));
        options.settings.save_masks = save.then(|| folder.path().join("masks"));
        let summary = run_headless(&options).unwrap();
        assert_eq!((summary.frames_rendered, summary.frames_with_mask), (8, 8), "{codec}");
        let picture = |frame: u32| std::fs::read(folder.path().join(format!("pictures/frame_{frame:06}.png"))).unwrap();
        let pictures: Vec<Vec<u8>> = (0..8).map(picture).collect();
        (pictures, stage.referenced(), summary.frames_bad)
    };
    let (expected, without, _) = pictures(CodecId::PlanesLz4, Script::default(), false);
    assert_eq!(without, 0);
    let (shown, referenced, bad) = pictures(CodecId::TilesSmall, Script::default(), false);
    assert!(shown == expected && referenced >= 5 && bad == 0, "{referenced} frames with references, {bad} bad");
    // The client reports that it lacks the reference, and the next mask is coded without.
    let foreign = Script { foreign: vec![3], ..Script::default() };
    let (shown, referenced, bad) = pictures(CodecId::TilesSmall, foreign, false);
    assert!(shown == expected && referenced >= 3 && bad == 1, "{referenced} frames with references, {bad} bad");
    // Saved masks are coded without references.
    assert_eq!(pictures(CodecId::TilesSmall, Script::default(), true).1, 0);
}

#[test]
fn frames_of_another_shape_are_counted_and_ignored() {
    let stage = Stage::start("lab-udp", Script { wrong_shape: vec![1], ..Script::default() });
    let folder = tempfile::tempdir().unwrap();
    let mut options = stage.options(folder.path());
    options.settings.wait = true;
    let summary = run_headless(&options).unwrap();
    assert_eq!((summary.frames_rendered, summary.frames_with_mask, summary.frames_bad), (4, 4, 1));
}

#[test]
fn a_server_that_leaves_ends_the_run_with_its_reason() {
    let stage = Stage::start("lab-tcp", Script { close_at: Some(2), ..Script::default() });
    let folder = tempfile::tempdir().unwrap();
    let mut options = stage.options(folder.path());
    options.settings.wait = true;
    let error = run_headless(&options).unwrap_err();
    assert!(matches!(error, ClientError::Ended { rendered: 2, wanted: 4, .. }), "{error:?}");
    assert!(error.to_string().contains("curtain"), "{error}");
}

#[test]
fn a_run_that_waits_for_its_mask_can_be_stopped() {
    // Frame 0 has its mask, and frame 1 never gets one.
    let stage = Stage::start("lab-udp", Script { lose: vec![(1, None); 10_000], ..Script::default() });
    let folder = tempfile::tempdir().unwrap();
    let mut options = stage.options(folder.path());
    options.settings.wait = true;
    options.settings.stats = Some(folder.path().join("stats.jsonl"));
    let (stop, stats) = (Stop::default(), folder.path().join("stats.jsonl"));
    let summary = std::thread::scope(|scope| {
        let run = scope.spawn(|| run_headless_until(&options, &stop));
        while !std::fs::read_to_string(&stats).is_ok_and(|text| text.ends_with('\n')) {
            assert!(!run.is_finished());
            std::thread::sleep(Duration::from_millis(10));
        }
        stop.ask(Cause::Terminate);
        run.join().unwrap().unwrap()
    });
    assert_eq!((summary.frames_rendered, summary.stopped_by), (1, Some("SIGTERM")));
    assert_eq!((summary.connection_lost, summary.lost_at_end), (None, None));
    assert!(stage.received_bye());
    // One that is stopped before its first frame has no summary.
    let early = run_headless_until(&options, &stop).unwrap_err();
    assert!(matches!(early, ClientError::Stopped(Cause::Terminate)), "{early}");
}

#[test]
fn a_refusal_keeps_the_servers_reason() {
    let refusals = [
        (Refusal::Token, "--token"),
        (Refusal::Version { server: 9, client: 1 }, "install matching versions"),
        (Refusal::Full { sessions: 3, retry_after_ms: 500 }, "3 sessions"),
        (Refusal::Draining, "draining"),
    ];
    for (refusal, text) in refusals {
        let answer = Some(ServerMessage::Refused(refusal));
        let stage = Stage::start("lab-tcp", Script { answer, ..Script::default() });
        let folder = tempfile::tempdir().unwrap();
        let error = run_headless(&stage.options(folder.path())).unwrap_err();
        assert!(matches!(error, ClientError::Refused(_)) && error.to_string().contains(text), "{error}");
        assert!(stage.scene_fetches().is_empty());
    }
}

#[test]
fn a_server_that_sends_another_scene_is_detected() {
    let stage = Stage::start("lab-tcp", Script { wrong_scene: true, ..Script::default() });
    let folder = tempfile::tempdir().unwrap();
    let error = run_headless(&stage.options(folder.path())).unwrap_err();
    assert!(matches!(error, ClientError::Fetch(_)), "{error}");
    let left: Vec<_> = std::fs::read_dir(folder.path().join("cache")).unwrap().collect();
    assert!(left.is_empty(), "{left:?}");
}
