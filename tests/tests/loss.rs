//! Promise: `lab loss` shows that slices keep what the dissertation's policy throws away.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use gnomon_protocol::codec::CodecId;
use gnomon_tests::{
    report::{
        loss::{LossOptions, measure},
        scene_args::SceneArgs,
    },
    scenes::real,
};

#[test]
fn slices_keep_what_whole_frames_throw_away() {
    let out = tempfile::tempdir().unwrap();
    let sponza = real::folder().unwrap().join("sponza");
    let options = LossOptions {
        scene: SceneArgs {
            scene: sponza.join("sponza_lights.gltf"),
            lights_from: None,
            lights: Some(4),
            path: Some(sponza.join("lights_camera.json#A_atrium_dolly").into()),
            size: (640, 360),
            frames: 60,
            out: out.path().to_owned(),
        },
        loss: vec![0.0, 5.0],
        burst: vec![1.0, 8.0],
        rtt_ms: 40.0,
        codecs: vec![CodecId::TilesSmall],
        seed: 1,
    };
    let table = measure(&options, |_| ()).unwrap();
    let csv = std::fs::read_to_string(out.path().join("loss.csv")).unwrap();
    assert_eq!(csv, table.csv());
    let head = "transport,codec,policy,fec,loss,burst,rtt_ms,frames_whole,tiles_in_time,bit_error,mean_bytes";
    assert_eq!(csv.lines().next().unwrap(), head);
    // Loss 0, 5 % each for itself, 5 % in bursts of 8; each under both policies.
    let figures = |row: usize| -> [f64; 3] { std::array::from_fn(|place| table.rows[row][7 + place].parse().unwrap()) };
    assert_eq!(table.rows.len(), 6, "{csv}");
    let [whole, tiles, error] = figures(0);
    assert_eq!([whole, tiles], [100.0; 2], "{csv}");
    assert!(error > 0.0, "the mask of an older pose is not that of a newer one");
    assert_eq!(figures(1), figures(0), "{csv}");
    for row in [2, 4] {
        let ([_, thrown_away, stale], [_, kept, better]) = (figures(row), figures(row + 1));
        assert!(kept > 90.0 && kept > thrown_away, "{csv}");
        assert!(better <= stale && better < 1.1 * error, "{csv}");
    }
}
