//! Promise: `lab loss` shows that slices keep tiles that the dissertation's whole-frame policy discards.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use gnomon_lab::{
    report::{loss::measure, scene_args::parse},
    scenes::real,
};

#[test]
fn slices_keep_what_whole_frames_throw_away() {
    let out = tempfile::tempdir().unwrap();
    let sponza = real::folder().unwrap().join("sponza");
    let line = "--lights 4 --size 640x360 --frames 60 --loss 0,5 --codecs tiles-small --warm-up 20";
    let (sponza, out_folder) = (sponza.display(), out.path().display());
    let path = format!("--scene {sponza}/sponza_lights.gltf --path {sponza}/lights_camera.json#A_atrium_dolly");
    let options = parse(&format!("{path} {line} --out {out_folder}")).unwrap();
    let table = measure(&options, |_| ()).unwrap();
    let csv = std::fs::read_to_string(out.path().join("loss.csv")).unwrap();
    assert_eq!(csv, table.csv());
    let head = "transport,codec,policy,fec,loss,burst,rtt_ms,frames_whole,tiles_in_time,bit_error,mean_bytes,lag_p99,\
                queue_dropped";
    assert_eq!(csv.lines().next().unwrap(), head);
    // Loss 0, 5 % independent, 5 % in bursts of 8; each with whole frames, slices, and slices with parity.
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
    // Parity repairs nearly all independent losses.
    assert!(figures(5)[1] > 99.0, "{csv}");
}
