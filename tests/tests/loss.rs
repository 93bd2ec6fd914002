//! Promise: `lab loss` shows that slices keep what the dissertation's policy throws away.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use gnomon_client::link::receive_options::Packets;
use gnomon_lab::{
    report::{
        loss::{LossOptions, measure},
        scene_args::SceneArgs,
    },
    scenes::real,
};
use gnomon_protocol::codec::CodecId;

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
        transport: vec!["model".to_owned()],
        packets: vec![Packets::WholeFrame, Packets::Slices, Packets::Parity],
        warm_up: 20,
        backend: "cpu".to_owned(),
        samples: 1,
        link: String::new(),
        allow_software: true,
        seed: 1,
    };
    let table = measure(&options, |_| ()).unwrap();
    let csv = std::fs::read_to_string(out.path().join("loss.csv")).unwrap();
    assert_eq!(csv, table.csv());
    let head = "transport,codec,policy,fec,loss,burst,rtt_ms,frames_whole,tiles_in_time,bit_error,mean_bytes,lag_p99,queue_dropped";
    assert_eq!(csv.lines().next().unwrap(), head);
    // Loss 0, 5 % each for itself, 5 % in bursts of 8; each in whole frames, slices, and slices with parity.
    let figures = |row: usize| -> [f64; 3] { std::array::from_fn(|place| table.rows[row][7 + place].parse().unwrap()) };
    assert_eq!(table.rows.len(), 9, "{csv}");
    let [whole, tiles, error] = figures(0);
    assert_eq!([whole, tiles], [100.0; 2], "{csv}");
    assert!(error > 0.0, "the mask of an older pose is not that of a newer one");
    assert_eq!((figures(1), figures(2)), (figures(0), figures(0)), "{csv}");
    assert_eq!(table.rows[2][10], table.rows[1][10], "parity without loss: {csv}");
    for row in [3, 6] {
        let [thrown_away, kept, mended] = [row, row + 1, row + 2].map(figures);
        assert!(kept[1] > 90.0 && kept[1] > thrown_away[1] && mended[1] >= kept[1], "{csv}");
        assert!(kept[2] <= thrown_away[2] && mended[2] <= kept[2] && mended[2] < 1.1 * error, "{csv}");
    }
    // Losses each for itself are mended nearly all.
    assert!(figures(5)[1] > 99.0, "{csv}");
}
