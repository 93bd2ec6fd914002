//! Promise: bad traffic disturbs nobody: garbage costs no memory, an address that never answers draws next to nothing, a flood of handshakes keeps no client
//! out, and no token is good that should not be. `lab hostile` says the same with a million packets.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use std::path::Path;

use gnomon_lab::report::hostile::{HostileOptions, run};

#[test]
fn bad_traffic_disturbs_nobody() {
    let assets = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets");
    let options = HostileOptions {
        scene: assets.join("cloister.glb"),
        path: format!("{}#walk", assets.join("cloister.json").display()).parse().unwrap(),
        packets: 20_000,
        handshakes: 500,
        seconds: 60,
        ignore_times: true,
    };
    let report = run(&options).unwrap();
    assert!(report.holds, "{}", report.table.markdown());
}
