//! Promise: `lab lag` and `lab network` report the error of late visibility, and a second run gives the same figures.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use gnomon_lab::{
    cloister,
    report::{
        lag::{self, LagOptions},
        network,
        scene_args::parse,
        table::Table,
    },
};
use gnomon_scene::testing::write_living_scene;
use serde_json::json;

fn only<'a>(table: &'a Table, wanted: &[(&str, &str)]) -> &'a [String] {
    let found: Vec<_> = table.rows.iter().filter(|row| wanted.iter().all(|(c, v)| table.text(row, c) == *v)).collect();
    assert_eq!(found.len(), 1, "rows {wanted:?}");
    found[0]
}

#[test]
fn error_against_lag_is_reported_for_every_way_of_predicting() {
    let out = tempfile::tempdir().unwrap();
    let line = "--lights 4 --size 160x90 --frames 3 --lags 0,3,12 --guard 0x0,64x36 --predict-pose off,velocity \
                --fps 30 --allow-software";
    let options: LagOptions = parse(&format!("{} {line} --out {}", cloister::options(), out.path().display())).unwrap();
    let rows = lag::measure(&options, |_| {}).unwrap();
    assert_eq!(std::fs::read_to_string(out.path().join("lag.csv")).unwrap(), rows.csv());
    assert_eq!(rows.rows.len(), 3 * 3 * 2 * 2);
    let row = |lag: &str, predictor: &str, guard: &str, pose: &str| {
        only(&rows, &[("lag", lag), ("predictor", predictor), ("guard", guard), ("server_prediction", pose)])
    };
    let plain = |lag: &str, predictor: &str| row(lag, predictor, "0x0", "off");
    let wrong = |row: &[String]| rows.number(row, "bit_error");
    // Without lag only the tracer's rounding is wrong, and the picture is the true one.
    assert!(wrong(plain("0", "surface")) < 0.02, "{:?}", plain("0", "surface"));
    assert!(rows.number(plain("0", "surface"), "flip") < 1e-3);
    for lag in ["3", "12"] {
        let (none, theirs, ours) = (plain(lag, "none"), plain(lag, "dissertation"), plain(lag, "surface"));
        assert!(wrong(ours) < 0.7 * wrong(theirs) && wrong(theirs) < wrong(none), "{none:?} {theirs:?} {ours:?}");
        for (measure, better) in [("psnr", 1.0), ("ssim", 1.0), ("flip", -1.0)] {
            assert!(better * (rows.number(ours, measure) - rows.number(theirs, measure)) > 0.0, "{measure} {ours:?}");
        }
        // A guard band raises the known share; extrapolated poses lower the error.
        let guarded = row(lag, "surface", "64x36", "off");
        assert!(rows.number(guarded, "known_share") > rows.number(ours, "known_share"), "{guarded:?}");
        let ahead = row(lag, "surface", "0x0", "velocity");
        assert!(wrong(ahead) < wrong(ours), "{ahead:?}");
    }
    let files = ["lag_bit_error.svg", "lag_psnr.svg", "lag_ssim.svg", "lag_flip.svg", "lag_grid.png"];
    assert!(files.iter().all(|file| out.path().join(file).is_file()));
}

#[test]
fn a_second_run_gives_the_same_figures() {
    let out = tempfile::tempdir().unwrap();
    let line = "--lights 4 --size 160x90 --frames 2 --lags 0,3 --guard 64x36 --predict-pose velocity --fps 30 \
                --bits-only --allow-software";
    let options: LagOptions = parse(&format!("{} {line} --out {}", cloister::options(), out.path().display())).unwrap();
    let [first, second] = [(); 2].map(|()| lag::measure(&options, |_| {}).unwrap());
    assert_eq!((first.rows.len(), first.csv()), (2 * 3, second.csv()));
}

#[test]
fn networks_are_compared_with_no_server() {
    let out = tempfile::tempdir().unwrap();
    let line = "--lights 4 --size 160x90 --frames 60 --profile lan,lte --runs 1 --seed 7 --mode concurrent,sequential \
                --samples 3 --fps 30 --backend cpu --allow-software";
    let options = parse(&format!("{} {line} --out {}", cloister::options(), out.path().display())).unwrap();
    let rows = network::measure(&options, |_| {}).unwrap();
    assert_eq!(std::fs::read_to_string(out.path().join("network.csv")).unwrap(), rows.csv());
    assert_eq!(rows.rows.len(), 4);
    for profile in ["lan", "lte"] {
        let row = |mode| only(&rows, &[("profile", profile), ("mode", mode)]);
        let (concurrent, sequential) = (row("concurrent"), row("sequential"));
        assert!(rows.number(concurrent, "visibility_fps") > 1.0 && rows.number(concurrent, "client_fps") > 1.0);
        assert!(rows.number(concurrent, "bit_error") < 10.0, "{concurrent:?}");
        assert!(rows.number(sequential, "lag_p50") >= 0.0 && rows.number(sequential, "degraded_share") < 1.0);
    }
    assert!(["network_frame_time.svg", "network_lag.svg"].iter().all(|file| out.path().join(file).is_file()));
}

#[test]
fn late_masks_of_what_moves_are_laid_where_it_has_gone() {
    let folder = tempfile::tempdir().unwrap();
    let scene = write_living_scene(folder.path()).unwrap();
    let key = |t: f64, x: f64| json!({"t": t, "pos": [x, 2.5, 5.0], "target": [0.0, 0.5, 0.0]});
    let path = folder.path().join("path.json");
    let keys = json!({"camera_path": {"keyframes": [key(0.0, -1.0), key(4.0, 1.5)]}});
    std::fs::write(&path, keys.to_string()).unwrap();
    let measured = |animation: &str| {
        let line = "--size 160x90 --frames 4 --lags 6 --predict dissertation,surface --predict-pose off,velocity \
                    --bits-only --allow-software";
        let (scene, path, out) = (scene.display(), path.display(), folder.path().display());
        let line = format!("--scene {scene} --path {path} --animation {animation} {line} --out {out}");
        let options: LagOptions = parse(&line).unwrap();
        let rows = lag::measure(&options, |_| {}).unwrap();
        let wrong = |predictor, pose| {
            rows.number(only(&rows, &[("predictor", predictor), ("server_prediction", pose)]), "bit_error")
        };
        [wrong("dissertation", "off"), wrong("surface", "off"), wrong("surface", "velocity")]
    };
    let [_, resting, _] = measured("off");
    for animation in ["slide", "travel", "all"] {
        let [theirs, ours, ahead] = measured(animation);
        println!("{animation}: {theirs} → {ours} %, {ahead} % with the server's look-ahead; {resting} % at rest");
        assert!(ours < 0.25 * theirs && ours < 0.5, "{animation}: {theirs} → {ours}");
        // The server traces what moves where it will be.
        assert!(ahead <= ours.max(resting), "{animation}: {ahead} with look-ahead, {ours} without");
    }
}
