//! `--demo`: a local server with the scene that this program carries.

use std::{fs, path::Path};

use anyhow::{Context as _, Result};

use super::local_server::{Folder, LocalScene, LocalServer};
use crate::link::url::ServerUrl;

const SCENE: &[u8] = include_bytes!("../../../tests/assets/cloister.glb");
const PATHS: &[u8] = include_bytes!("../../../tests/assets/cloister.json");

/// The running demo. Dropping it stops it, and takes its files away.
pub struct Demo {
    server: LocalServer,
    path: String,
}

impl Demo {
    /// Starts the server and waits until it listens.
    pub fn start() -> Result<Self> {
        Self::in_its_folder().context("--demo")
    }

    fn in_its_folder() -> Result<Self> {
        // A missing server is worth saying before anything is written.
        LocalServer::program()?;
        let folder = Folder::make("demo")?;
        let (file, paths) = (folder.path().join("cloister.glb"), folder.path().join("cloister.json"));
        let write = |file: &Path, bytes| fs::write(file, bytes).with_context(|| format!("writing {}", file.display()));
        write(&file, SCENE)?;
        write(&paths, PATHS)?;
        let server = LocalServer::start(folder, &LocalScene { file, lights_from: None, lights: None })?;
        Ok(Self { server, path: format!("{}#walk", paths.display()) })
    }

    /// Where it listens.
    pub fn url(&self) -> &ServerUrl {
        self.server.url()
    }

    /// A camera path through the scene.
    pub fn path(&self) -> &str {
        &self.path
    }
}
