//! Promise: on generated scenes that are hard to trace, every back end stays within every bound: no light leaks, no
//! self-shadowing. `lab accuracy` checks larger pictures and meshes.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use std::collections::BTreeSet;

use gnomon_lab::{
    backends::BackendName,
    hard_cases,
    report::accuracy::{self, AccuracyOptions, Part},
    rig::ray_queries::with_ray_queries,
};

fn assert_within_bounds(size: (u32, u32), backends: &[BackendName]) {
    let cases = hard_cases::all(size, false).unwrap();
    let mut table = hard_cases::run(&cases, backends, |case, backend, _, _| {
        println!("{} on {}", case.name, backend.name());
        Ok(())
    })
    .unwrap();
    let judged = table.rows.iter().map(|row| (&row[0], &row[1])).collect::<BTreeSet<_>>();
    assert_eq!(judged.len(), cases.len() * backends.len(), "every back end runs every case");
    table.rows.extend(hard_cases::left_out().unwrap());
    let broken: Vec<_> = table.rows.iter().filter(|row| row[5] != "true").map(|row| row.join(",")).collect();
    assert!(broken.is_empty(), "{}", broken.join("\n"));
}

#[test]
fn every_back_end_stays_within_every_bound() {
    assert_within_bounds((112, 64), &BackendName::EVERYWHERE);
}

#[test]
fn ray_query_stays_within_every_bound() {
    let probe = hard_cases::all((8, 8), false).unwrap().remove(0).scene;
    with_ray_queries("ray_query_stays_within_every_bound", &probe, || {
        assert_within_bounds((64, 40), &[BackendName::RayQuery]);
    })
    .unwrap();
}

#[test]
fn the_report_has_a_table_and_a_picture_of_each_case() {
    let out = tempfile::tempdir().unwrap();
    let options = AccuracyOptions {
        scenes: None,
        only: Vec::new(),
        size: (64, 36),
        cases: vec!["coplanar".into(), "aimed".into()],
        case_size: (64, 36),
        parts: vec![Part::Cases],
        backends: vec![BackendName::Cpu],
        out: out.path().to_owned(),
    };
    let judged = accuracy::measure(&options, |line| println!("{line}")).unwrap();
    assert!(judged.scenes.rows.is_empty());
    let csv = std::fs::read_to_string(out.path().join("hard_cases.csv")).unwrap();
    let mut lines = csv.lines();
    assert_eq!(lines.next(), Some("case,backend,measure,value,bound,holds"));
    let rows: Vec<_> = lines.collect();
    assert!(rows.contains(&"aimed-at-edges-0,cpu,leaks,0,0,true"), "{csv}");
    assert!(rows.contains(&"vertex-nan,loader,kept,0,0,true"), "{csv}");
    for case in ["coplanar", "coplanar-tilted", "aimed-at-edges-0", "aimed-at-edges-0.04"] {
        assert!(rows.iter().any(|row| row.starts_with(&format!("{case},cpu,"))), "{csv}");
        let picture = image::open(out.path().join(format!("case-{case}-cpu.png"))).unwrap();
        assert_eq!((picture.width(), picture.height()), (64, 36));
    }
}
