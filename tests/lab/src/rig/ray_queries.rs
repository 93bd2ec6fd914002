//! Tests on an adapter that has ray queries, which few machines have.
//!
//! A Vulkan loader chooses its driver when it is first asked, from VK_DRIVER_FILES. So a test starts its program again for
//! itself alone, with the driver that `deploy/ray-query-driver` laid out. Without one, and without an adapter of the
//! machine's own that has ray queries, it says on the terminal that it did not run. `make test` fetches the driver, and
//! names it in GNOMON_RAY_QUERY_DRIVER: then it must be there, and must do.

use std::{
    env,
    io::Write as _,
    path::{Path, PathBuf},
    process::Command,
};

use anyhow::{Result, ensure};
use gnomon_scene::Scene;

use crate::backends::BackendName;

/// Names the driver file, and makes its absence a failure.
const DRIVER: &str = "GNOMON_RAY_QUERY_DRIVER";
/// Tells the program that it is the one that was started with the driver.
const CHILD: &str = "GNOMON_RAY_QUERY_CHILD";

/// The driver file that the environment names, or that was fetched; `None` when there is none.
///
/// # Errors
/// When the environment names what is no file.
pub fn driver() -> Result<Option<PathBuf>> {
    if let Some(named) = env::var_os(DRIVER) {
        let path = PathBuf::from(named);
        ensure!(path.is_file(), "{DRIVER} names {}, which is no file", path.display());
        return Ok(Some(path));
    }
    let fetched = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../target/ray-query-driver/lvp_icd.json");
    Ok(fetched.is_file().then_some(fetched))
}

/// Runs `body` where there are ray queries: in this program started again as `test` alone, or here. `probe` is a scene
/// to try the machine's own adapter with.
///
/// # Errors
/// When the program that was started again fails, or cannot be started.
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
    // Not `eprintln`, which the harness keeps to itself when a test passes.
    let line = format!("NOT RUN: {test}: no adapter here has ray queries (deploy/ray-query-driver lays one out)\n");
    Ok(std::io::stderr().write_all(line.as_bytes())?)
}
