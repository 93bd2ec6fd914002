//! Promise: on generated scenes that are hard to trace, every back end stays within every bound: no light leaks, and no
//! surface shadows itself.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use gnomon_tests::{backends::BackendName, hard_cases};

#[test]
fn every_back_end_stays_within_every_bound() {
    let cases = hard_cases::all((112, 64), false).unwrap();
    let table = hard_cases::run(&cases, &BackendName::EVERYWHERE, |case, backend, _, _| {
        println!("{} on {}", case.name, backend.name());
        Ok(())
    })
    .unwrap();
    let judged = table.rows.iter().map(|row| (&row[0], &row[1])).collect::<std::collections::BTreeSet<_>>();
    assert_eq!(judged.len(), cases.len() * BackendName::EVERYWHERE.len(), "every back end runs every case");
    let broken: Vec<_> = table.rows.iter().filter(|row| row[5] != "true").map(|row| row.join(",")).collect();
    assert!(broken.is_empty(), "{}", broken.join("\n"));
}
