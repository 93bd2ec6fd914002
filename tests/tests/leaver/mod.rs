//! Clients as processes that are watched through their statistics and asked to leave.

#![allow(dead_code, reason = "each test program uses a part")]

use std::{
    ffi::OsString,
    fs,
    path::{Path, PathBuf},
    process::Command,
    time::{Duration, Instant},
};

use gnomon_lab::rig::{
    PATIENCE,
    program::{Program, find},
};
use serde_json::Value;

/// A small scene with two lights, a path through it, and a place for a client's files.
pub(crate) struct Stage {
    folder: tempfile::TempDir,
    pub(crate) scene: PathBuf,
}

impl Stage {
    pub(crate) fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let scene = gnomon_scene::testing::write_scene(folder.path()).unwrap();
        let text = r#"{"camera_path": {"keyframes": [{"t": 0, "pos": [0, 2.5, 3], "target": [0, 0, 0]},
            {"t": 600, "pos": [3, 2.5, 0], "target": [0, 0, 0]}]}}"#;
        fs::write(folder.path().join("path.json"), text).unwrap();
        Self { folder, scene }
    }

    pub(crate) fn file(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Returns a client's arguments for small pictures, 20 a second.
    pub(crate) fn arguments(&self, url: &str, frames: u32, more: &[&str]) -> Vec<OsString> {
        let mut all: Vec<OsString> = vec![url.into(), "--headless".into(), "--path".into()];
        all.push(self.file("path.json").into());
        all.extend(["--size", "64x48", "--fps", "20", "--allow-software", "--frames"].map(OsString::from));
        all.push(frames.to_string().into());
        all.extend(more.iter().map(OsString::from));
        all
    }

    pub(crate) fn client(&self, url: &str, frames: u32, more: &[&str], log: &str) -> Program {
        Program::start(&find("gnomon-client").unwrap(), &self.arguments(url, frames, more), &[("RUST_LOG", log)])
            .unwrap()
    }
}

pub(crate) fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// Returns the whole lines of a file of JSON lines; an incomplete last line is left out.
pub(crate) fn lines(file: &Path) -> Vec<Value> {
    let text = fs::read_to_string(file).unwrap_or_default();
    let whole = text.rfind('\n').map_or("", |end| &text[..end]);
    whole.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

/// Waits until the statistics of a running client are `wanted`.
pub(crate) fn watch<T>(client: &mut Program, stats: &Path, wanted: impl Fn(&[Value]) -> Option<T>) -> T {
    let begun = Instant::now();
    loop {
        if let Some(found) = wanted(&lines(stats)) {
            return found;
        }
        assert!(client.is_running().unwrap(), "it ended early: {:?}", client.said());
        assert!(begun.elapsed() < PATIENCE, "{:?}: {:?}", lines(stats).last(), client.said());
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// Waits until a client has drawn this many frames.
pub(crate) fn watch_frames(client: &mut Program, stats: &Path, frames: usize) {
    watch(client, stats, |lines| (lines.len() >= frames).then_some(()));
}

pub(crate) fn signal(program: &Program, name: &str) {
    let sent = Command::new("kill").args([&format!("-{name}"), &program.id().to_string()]).status().unwrap();
    assert!(sent.success(), "kill -{name}");
}

/// Starts a server on the `cpu` back end at this address, and returns its URL.
pub(crate) fn serve(scene: &Path, address: &str, certificate: &Path, more: &[&str]) -> (Program, String) {
    let mut all = vec!["--scene", text(scene), "--listen", address, "--backend", "cpu"];
    all.extend(["--cert-dir", text(certificate)]);
    all.extend(more);
    let mut server = Program::start(&find("gnomon-server").unwrap(), &all, &[]).unwrap();
    let url = server.wait_for(PATIENCE, |said| {
        let whole = said.get(..said.rfind('\n')? + 1)?;
        whole.split_whitespace().find(|word| word.starts_with("gnomon://")).map(str::to_owned)
    });
    (server, url.unwrap())
}

/// Returns HOST:PORT of a URL.
pub(crate) fn address_of(url: &str) -> &str {
    url.split_once("://").unwrap().1.split('/').next().unwrap()
}

/// Returns the words after the program's name in the last line of standard error.
pub(crate) fn complaint(stderr: &str) -> &str {
    let last = stderr.lines().rfind(|line| !line.trim().is_empty()).unwrap_or_default();
    assert!(!stderr.contains("panicked"), "{stderr}");
    last.strip_prefix("gnomon-client: ").unwrap_or_else(|| panic!("it complains of nothing: {stderr:?}"))
}
