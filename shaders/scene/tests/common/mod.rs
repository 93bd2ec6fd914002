//! Finds the test scenes.

pub(crate) mod formats;
pub(crate) mod gltf_file;

use std::path::{Path, PathBuf};

use gnomon_scene::LoadOptions;

/// Returns the folder that `GNOMON_SCENES` names.
#[allow(dead_code, reason = "each test file uses what it needs")]
pub(crate) fn scenes() -> PathBuf {
    match std::env::var_os("GNOMON_SCENES") {
        Some(folder) => folder.into(),
        None => panic!("set GNOMON_SCENES to the folder with the unpacked test scenes"),
    }
}

/// Returns every file below a folder, sorted.
#[allow(dead_code, reason = "each test file uses what it needs")]
pub(crate) fn files(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
    let mut paths: Vec<PathBuf> = entries.filter_map(|entry| entry.ok().map(|entry| entry.path())).collect();
    paths.sort();
    paths.into_iter().flat_map(|path| if path.is_dir() { files(&path) } else { vec![path] }).collect()
}

/// Writes a lights file with one light into `folder`. With these options no scene fails for lack of lights.
#[allow(dead_code, reason = "each test file uses what it needs")]
pub(crate) fn one_light(folder: &Path) -> LoadOptions {
    let lights = folder.join("lights.json");
    std::fs::write(&lights, r#"{"lights":[{"type":"point","position":[0,1,0]}]}"#).unwrap();
    LoadOptions { lights_from: Some(lights), ..LoadOptions::default() }
}

/// Returns the largest resident size that this process has had.
#[allow(dead_code, reason = "each test file uses what it needs")]
pub(crate) fn peak_kib() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").expect("this test reads /proc, as Linux has it");
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).unwrap();
    line.trim().trim_end_matches(" kB").trim().parse().unwrap()
}
