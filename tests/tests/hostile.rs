//! Promise: bad traffic affects no good client. Garbage costs no memory, an address that never answers gets almost no
//! bytes, connections that never become sessions are closed and forgotten over both protocols, a flood of handshakes
//! from several addresses keeps no client out, and no invalid token is accepted. `lab hostile` checks the same with a
//! million packets, `tests/lab/hostile-namespaces` with other addresses than loopback's.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use gnomon_lab::{
    cloister,
    report::{hostile::run, scene_args::parse},
};

#[test]
fn bad_traffic_affects_no_good_client() {
    let line = "--packets 20000 --handshakes 4000 --connections 60 --bytes 3000000 --seconds 60 --ignore-times";
    let report = run(&parse(&format!("{} {line}", cloister::options())).unwrap()).unwrap();
    assert!(report.holds, "{}", report.table.markdown());
}
