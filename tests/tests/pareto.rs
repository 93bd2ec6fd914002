//! Promise: `lab pareto` varies every setting, and its table has the savings and cost of each.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use std::collections::HashMap;

use gnomon_lab::{
    report::pareto::{ParetoOptions, measure},
    scenes::real,
};

const HEAD: &str =
    "scene,backend,knob,value,ms_p50,ms_p99,rays,node_visits,bytes,bit_error,psnr,flip,on_front,is_default";

#[test]
fn every_setting_has_a_row_with_its_savings_and_cost() {
    let out = tempfile::tempdir().unwrap();
    let options = ParetoOptions {
        scenes: real::folder().unwrap(),
        only: vec!["grey-white-room".into()],
        backends: vec!["cpu".into(), "compute".into()],
        size: (96, 64),
        samples: 1,
        seconds: 1.0,
        out: out.path().to_owned(),
    };
    let mut said = Vec::new();
    measure(&options, |line| said.push(line.to_owned())).unwrap();
    let csv = std::fs::read_to_string(out.path().join("pareto.csv")).unwrap();
    let mut lines = csv.lines();
    assert_eq!(lines.next().unwrap(), HEAD);
    let rows: Vec<Vec<&str>> = lines.map(|line| line.split(',').collect()).collect();
    let column = |name: &str| HEAD.split(',').position(|column| column == name).unwrap();
    let number = |row: &[&str], name: &str| row[column(name)].parse::<f64>().unwrap();
    let by_knob: HashMap<[String; 3], &Vec<&str>> =
        rows.iter().map(|row| ([row[1], row[2], row[3]].map(str::to_owned), row)).collect();
    let row = |backend: &str, knob: &str, value: &str| by_knob[&[backend, knob, value].map(str::to_owned)];
    assert_eq!(by_knob.len(), rows.len(), "two rows say the same");

    for backend in ["cpu", "compute"] {
        let of = |value: &str| row(backend, "resolution", value);
        let full = of("full");
        assert!(number(full, "bit_error") < 0.2, "{full:?}");
        assert!(number(full, "psnr") > 35.0 && number(full, "flip") < 0.01, "{full:?}");
        let half = of("half-mask");
        assert!(number(half, "rays") < 0.3 * number(full, "rays"), "{half:?}");
        assert!(number(half, "bit_error") > number(full, "bit_error"), "{half:?}");
        assert!(number(half, "flip") > number(full, "flip") && number(half, "flip") < 0.2, "{half:?}");
    }
    let nodes = |value: &str| number(row("cpu", "resolution", value), "node_visits");
    assert!(nodes("full") > nodes("half-mask"));
    for roundings in [1, 16, 256, 4096] {
        row("compute", "offset", &format!("{roundings} roundings"));
    }
    // Further settings, measured with the machine's own back end.
    let default = rows.iter().find(|row| row[2] == "resolution" && row[column("is_default")] == "true").unwrap();
    let of = |knob: &str, value: &str| row(default[1], knob, value);
    assert!(number(of("codec", "words"), "bytes") > number(default, "bytes"));
    for codec in ["tiles-small", "tiles-fast"] {
        let rows = [of("codec", codec)]
            .into_iter()
            .chain([0.05, 0.2, 0.5].map(|share| of("lossy", &format!("{codec} {share} %"))));
        let trades: Vec<_> = rows.map(|row| (number(row, "bytes"), number(row, "bit_error"))).collect();
        assert!(
            trades.is_sorted_by(|(more, fewer_wrong), (fewer, more_wrong)| more > fewer && fewer_wrong < more_wrong),
            "{trades:?}"
        );
    }
    for period in ["every 2 frames", "every 4 frames"] {
        assert!(number(of("dim lights", period), "rays") < number(default, "rays"));
    }
    for lag in [1, 2, 4, 8] {
        let [surface, dissertation, none] = ["surface", "dissertation", "none"]
            .map(|predictor| number(of("lag", &format!("{lag} {predictor}")), "bit_error"));
        assert!(surface < dissertation.max(none), "lag {lag}: {surface}, {dissertation}, {none}");
    }
    assert!(rows.iter().any(|row| row[2] == "lag" && row[column("is_default")] == "true"));
    // Each default off the front is reported, and nothing else.
    let off =
        rows.iter().filter(|row| row[column("is_default")] == "true" && row[column("on_front")] == "false").count();
    assert_eq!(said.iter().filter(|line| line.starts_with("DEFAULT OFF THE FRONT")).count(), off, "{said:?}");
    let plot = std::fs::read_to_string(out.path().join("pareto-grey-white-room.svg")).unwrap();
    assert!(plot.starts_with("<svg") && plot.contains("default") && plot.contains("compute"));
}
