//! Tests on an adapter with ray queries, which few machines have.
//!
//! A Vulkan loader reads VK_DRIVER_FILES once, on first use. So a test runs its program again for itself alone, with
//! the driver of `deploy/ray-query-driver`. Without the driver, and without such an adapter in the machine, it prints
//! that it did not run. `make test` fetches the driver and names it in GNOMON_RAY_QUERY_DRIVER, which makes its absence
//! a failure.

use std::{
    env,
    io::Write as _,
    path::{Path, PathBuf},
    process::Command,
};

use anyhow::{Result, ensure};
use gnomon_scene::Scene;

use crate::backends::BackendName;

/// Names the driver file; its absence is then a failure.
const DRIVER: &str = "GNOMON_RAY_QUERY_DRIVER";
/// Marks the program that was started with the driver.
const CHILD: &str = "GNOMON_RAY_QUERY_CHILD";

/// Returns the driver file: the one in the environment, or the fetched one.
pub fn driver() -> Result<Option<PathBuf>> {
    if let Some(named) = env::var_os(DRIVER) {
        let path = PathBuf::from(named);
        ensure!(path.is_file(), "{DRIVER} names {}, which is no file", path.display());
        return Ok(Some(path));
    }
    let fetched = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../target/ray-query-driver/lvp_icd.json");
    Ok(fetched.is_file().then_some(fetched))
}

/// Runs `body` with ray queries: in this program started again for `test` alone, or here if the machine's own adapter
/// supports the scene `probe`.
pub fn with_ray_queries(test: &str, probe: &Scene, body: impl FnOnce()) -> Result<()> {
    if env::var_os(CHILD).is_some() {
        body();
        return Ok(());
    }
    if let Some(driver) = driver()? {
        let mut child = Command::new(env::current_exe()?);
        child.args([test, "--exact", "--nocapture"]).env(CHILD, "1").env("VK_DRIVER_FILES", driver);
        let output = child.output()?;
        let said = format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
        ensure!(output.status.success(), "{said}");
        ensure!(said.contains("1 passed"), "no test is named {test}: {said}");
        return Ok(());
    }
    if BackendName::RayQuery.is_here(probe)? {
        body();
        return Ok(());
    }
    // Not `eprintln`, which the harness captures.
    let line = format!("NOT RUN: {test}: no adapter here has ray queries (deploy/ray-query-driver lays one out)\n");
    Ok(std::io::stderr().write_all(line.as_bytes())?)
}
