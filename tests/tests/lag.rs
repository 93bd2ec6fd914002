//! Promise: `lab lag` and `lab network` say how wrong late visibility is, with figures that a second run repeats.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use std::path::{Path, PathBuf};

use gnomon_client::{guard::GuardSize, mode::Mode, predictor::Predictor};
use gnomon_lab::report::{
    lag::{self, LagOptions, PosePrediction},
    network::{self, NetworkOptions},
    scene_args::SceneArgs,
};

fn asset(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("assets").join(name)
}

fn cloister(out: &Path, size: (u32, u32), frames: u32) -> SceneArgs {
    SceneArgs {
        scene: asset("cloister.glb"),
        lights_from: None,
        lights: Some(4),
        path: Some(format!("{}#walk", asset("cloister.json").display()).into()),
        size,
        frames,
        out: out.to_owned(),
    }
}

/// The rows of a table, by the names of its columns.
struct Rows {
    head: Vec<String>,
    rows: Vec<Vec<String>>,
}

impl Rows {
    fn read(file: &Path) -> Self {
        let text = std::fs::read_to_string(file).unwrap();
        let mut lines = text.lines().map(|line| line.split(',').map(str::to_owned).collect::<Vec<_>>());
        let head = lines.next().unwrap();
        let rows: Vec<_> = lines.collect();
        assert!(rows.iter().all(|row| row.len() == head.len()));
        Self { head, rows }
    }

    fn text<'a>(&self, row: &'a [String], column: &str) -> &'a str {
        let place = self.head.iter().position(|name| name == column).expect(column);
        &row[place]
    }

    fn number(&self, row: &[String], column: &str) -> f64 {
        self.text(row, column).parse().unwrap()
    }

    /// The row that has these values.
    fn find(&self, wanted: &[(&str, &str)]) -> &[String] {
        let mut found =
            self.rows.iter().filter(|row| wanted.iter().all(|(column, value)| self.text(row, column) == *value));
        let row = found.next().unwrap_or_else(|| panic!("no row {wanted:?}"));
        assert!(found.next().is_none(), "two rows {wanted:?}");
        row
    }
}

#[test]
fn error_against_lag_is_reported_for_every_way_of_predicting() {
    let out = tempfile::tempdir().unwrap();
    let options = LagOptions {
        scene: cloister(out.path(), (160, 90), 3),
        lags: vec![0, 3, 12],
        predict: vec![Predictor::None, "dissertation".parse().unwrap(), Predictor::Surface],
        guard: vec![GuardSize { width: 0, height: 0 }, GuardSize { width: 64, height: 36 }],
        predict_pose: vec![PosePrediction::Off, PosePrediction::Velocity],
        fps: 30.0,
        turn: None,
        ignore_alpha: false,
        allow_software: true,
        bits_only: false,
    };
    lag::measure(&options, |_| {}).unwrap();
    let rows = Rows::read(&out.path().join("lag.csv"));
    assert_eq!(rows.rows.len(), 3 * 3 * 2 * 2);
    let row = |lag: &str, predictor: &str, guard: &str, pose: &str| {
        rows.find(&[("lag", lag), ("predictor", predictor), ("guard", guard), ("server_prediction", pose)])
    };
    let plain = |lag: &str, predictor: &str| row(lag, predictor, "0x0", "off");
    let wrong = |row: &[String]| rows.number(row, "bit_error");
    // Without lag nothing is wrong but what the tracer rounds, and the picture is the true one.
    assert!(wrong(plain("0", "surface")) < 0.02, "{:?}", plain("0", "surface"));
    assert!(rows.number(plain("0", "surface"), "flip") < 1e-3);
    for lag in ["3", "12"] {
        let (none, theirs, ours) = (plain(lag, "none"), plain(lag, "dissertation"), plain(lag, "surface"));
        assert!(wrong(ours) < 0.7 * wrong(theirs) && wrong(theirs) < wrong(none), "{none:?} {theirs:?} {ours:?}");
        for (measure, better) in [("psnr", 1.0), ("ssim", 1.0), ("flip", -1.0)] {
            assert!(better * (rows.number(ours, measure) - rows.number(theirs, measure)) > 0.0, "{measure} {ours:?}");
        }
        // More is known with a guard band, and less is wrong where the server looked ahead.
        let guarded = row(lag, "surface", "64x36", "off");
        assert!(rows.number(guarded, "known_share") > rows.number(ours, "known_share"), "{guarded:?}");
        let ahead = row(lag, "surface", "0x0", "velocity");
        assert!(wrong(ahead) < wrong(ours), "{ahead:?}");
    }
    let files = ["lag_bit_error.svg", "lag_psnr.svg", "lag_ssim.svg", "lag_flip.svg", "lag_grid.png"];
    assert!(files.iter().all(|file| out.path().join(file).is_file()));
    let first = std::fs::read_to_string(out.path().join("lag.csv")).unwrap();
    lag::measure(&LagOptions { bits_only: true, ..options }, |_| {}).unwrap();
    let second = Rows::read(&out.path().join("lag.csv"));
    assert!(first.contains("lag") && rows.rows.iter().zip(&second.rows).all(|(a, b)| a[..10] == b[..10]));
}

#[test]
fn networks_are_set_against_none() {
    let out = tempfile::tempdir().unwrap();
    let options = NetworkOptions {
        scene: cloister(out.path(), (160, 90), 60),
        profile: vec!["lan".into(), "lte".into()],
        runs: 1,
        seed: 7,
        mode: vec![Mode::Concurrent, Mode::Sequential],
        samples: 3,
        transport: "quic".into(),
        fps: Some(30.0),
        backend: "cpu".into(),
        allow_software: true,
    };
    network::measure(&options, |_| {}).unwrap();
    let rows = Rows::read(&out.path().join("network.csv"));
    assert_eq!(rows.rows.len(), 4);
    for profile in ["lan", "lte"] {
        let row = |mode| rows.find(&[("profile", profile), ("mode", mode)]);
        let (concurrent, sequential) = (row("concurrent"), row("sequential"));
        assert!(rows.number(concurrent, "visibility_fps") > 1.0 && rows.number(concurrent, "client_fps") > 1.0);
        assert!(rows.number(concurrent, "bit_error") < 10.0, "{concurrent:?}");
        assert!(rows.number(sequential, "lag_p50") >= 0.0 && rows.number(sequential, "degraded_share") < 1.0);
    }
    assert!(["network_frame_time.svg", "network_lag.svg"].iter().all(|file| out.path().join(file).is_file()));
}
