//! Promise: bad traffic affects no good client. Garbage costs no memory, an address that never answers gets almost no
//! bytes, a flood of handshakes keeps no client out, and no invalid token is accepted. `lab hostile` checks the same
//! with a million packets.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use gnomon_lab::{
    cloister,
    report::{hostile::run, scene_args::parse},
};

#[test]
fn bad_traffic_affects_no_good_client() {
    let line = "--packets 20000 --handshakes 500 --seconds 60 --ignore-times";
    let report = run(&parse(&format!("{} {line}", cloister::options())).unwrap()).unwrap();
    assert!(report.holds, "{}", report.table.markdown());
}
