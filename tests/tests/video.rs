//! Promise: `lab video` compares both methods on the same walk, and predicted visibility does not suffer from delay as
//! video does.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use std::path::Path;

use gnomon_lab::{
    cloister,
    report::{
        scene_args::parse,
        video::{VideoOptions, measure},
    },
};

const HEAD: &str = "scene,path,size,fps,method,setting,rtt_ms,lag,frame_bytes,mbit_per_s,psnr,ssim,flip,vmaf";

fn walk(out: &Path, more: &str) -> VideoOptions {
    let line =
        "--lights 2 --rates 0.5,4 --preset ultrafast --codecs tiles-fast --warm 12 --ffmpeg ffmpeg --allow-software";
    parse(&format!("{} {line} --out {} {more}", cloister::options(), out.display())).unwrap()
}

#[test]
fn both_methods_are_measured_and_only_video_suffers_from_delay() {
    let out = tempfile::tempdir().unwrap();
    let options = walk(out.path(), "--size 160x90 --frames 4");
    let table = measure(&options, |_| ()).unwrap();
    let csv = std::fs::read_to_string(out.path().join("video.csv")).unwrap();
    assert_eq!(csv, table.csv());
    assert_eq!(csv.lines().next().unwrap(), HEAD);
    let column = |name: &str| HEAD.split(',').position(|column| column == name).unwrap();
    let number = |setting: &str, rtt_ms: &str, name: &str| -> f64 {
        let wanted = |row: &&Vec<String>| {
            let ahead = !row[column("method")].contains("not looking ahead");
            ahead && row[column("setting")] == setting && row[column("rtt_ms")] == rtt_ms
        };
        let rows: Vec<_> = table.rows.iter().filter(wanted).collect();
        assert_eq!(rows.len(), 1, "{setting} at {rtt_ms} ms: {csv}");
        rows[0][column(name)].parse().unwrap()
    };
    for codec in ["x264", "x265"] {
        let (low, high) = (format!("{codec} 0.5 Mbit/s"), format!("{codec} 4 Mbit/s"));
        assert!(number(&low, "0", "psnr") < number(&high, "0", "psnr"), "{csv}");
        assert!(number(&low, "0", "mbit_per_s") < number(&high, "0", "mbit_per_s"), "{csv}");
        // Four frames of lag cost more quality than any of these rates.
        assert!(number(&high, "60", "psnr") + 3.0 < number(&high, "0", "psnr"), "{csv}");
        assert!(number(&high, "60", "psnr") < number("tiles-fast", "60", "psnr"), "{csv}");
    }
    assert_eq!(number("x264 4 Mbit/s", "60", "lag"), 4.0);
    // Without lag the client shows the very pictures that it is judged by.
    assert!(number("tiles-fast", "0", "psnr").is_infinite(), "{csv}");
    assert!(number("tiles-fast", "60", "psnr") > number("shadow maps", "0", "psnr"), "{csv}");
    let behind = |row: &&Vec<String>| row[column("method")] == "visibility, not looking ahead";
    let behind: f64 = table.rows.iter().find(behind).unwrap()[column("psnr")].parse().unwrap();
    assert!(behind <= number("tiles-fast", "60", "psnr") && behind > number("x264 4 Mbit/s", "60", "psnr"), "{csv}");
    assert!(out.path().join("video_psnr.svg").is_file());
}

#[test]
fn a_walk_that_is_too_short_is_refused_before_anything_is_drawn() {
    let out = tempfile::tempdir().unwrap();
    let options = walk(out.path(), "--rtt 0 --size 64x36 --frames 1000000");
    let error = measure(&options, |_| ()).unwrap_err().to_string();
    assert!(error.contains("1000012 frames") && error.contains("walk"), "{error}");
}
