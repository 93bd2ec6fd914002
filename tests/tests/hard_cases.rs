//! Promise: on generated scenes that are hard to trace, every back end stays within every bound: no light leaks, and no
//! surface shadows itself. `lab accuracy` asks the same of larger pictures and heaps.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use std::collections::BTreeSet;

use gnomon_tests::{backends::BackendName, hard_cases, rig::ray_queries::with_ray_queries};

fn assert_within_bounds(size: (u32, u32), backends: &[BackendName]) {
    let cases = hard_cases::all(size, false).unwrap();
    let mut table = hard_cases::run(&cases, backends, |case, backend, _, _| {
        println!("{} on {}", case.name, backend.name());
        Ok(())
    })
    .unwrap();
    let judged = table.rows.iter().map(|row| (&row[0], &row[1])).collect::<BTreeSet<_>>();
    assert_eq!(judged.len(), cases.len() * backends.len(), "every back end runs every case");
    table.rows.extend(hard_cases::refusals());
    let broken: Vec<_> = table.rows.iter().filter(|row| row[5] != "true").map(|row| row.join(",")).collect();
    assert!(broken.is_empty(), "{}", broken.join("\n"));
}

#[test]
fn every_back_end_stays_within_every_bound() {
    assert_within_bounds((112, 64), &BackendName::EVERYWHERE);
}

#[test]
fn so_does_the_one_with_ray_queries() {
    let probe = hard_cases::all((8, 8), false).unwrap().remove(0).scene;
    with_ray_queries("so_does_the_one_with_ray_queries", &probe, || {
        assert_within_bounds((64, 40), &[BackendName::RayQuery]);
    })
    .unwrap();
}
