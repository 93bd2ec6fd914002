//! `--demo`: a local server with the scene built into this program.

use std::{fs, path::Path};

use anyhow::{Context as _, Result};
use gnomon_shaders::gpu::Gpu;

use super::local_server::{LocalScene, LocalServer, temporary_folder};
use crate::link::url::ServerUrl;

const SCENE: &[u8] = include_bytes!("../../../tests/assets/cloister.glb");
const PATHS: &[u8] = include_bytes!("../../../tests/assets/cloister.json");

/// What a person may move, unless told otherwise: what stands and hangs in the cloister.
const EDITABLE: &str = "bench,pot,trough,urn,sundial,well,tree,banner,lantern south-west,lantern south-east,lantern \
                        west,lantern east,spot housing";

/// A running demo. Dropping it stops the server and removes its files.
pub struct Demo {
    server: LocalServer,
    path: String,
}

impl Demo {
    /// Starts the server and waits until it listens. `editable` names what may be moved, a few things if it is `None`.
    /// Without an `animation`, things move if there is a real GPU of the name `adapter`: software Vulkan takes several
    /// times as long for a late mask of a scene that moves.
    ///
    /// # Errors
    /// Errors if there is no server program, or it does not start.
    pub fn start(animation: Option<String>, editable: Option<&str>, adapter: Option<&str>) -> Result<Self> {
        let moves = || (pollster::block_on(Gpu::count(adapter)) > 0).then(|| "all".to_owned());
        Self::start_server(animation.or_else(moves), editable.unwrap_or(EDITABLE)).context("--demo")
    }

    fn start_server(animation: Option<String>, editable: &str) -> Result<Self> {
        // Reports a missing server before writing anything.
        LocalServer::program()?;
        let folder = temporary_folder("demo")?;
        let (file, paths) = (folder.path().join("cloister.glb"), folder.path().join("cloister.json"));
        let write = |file: &Path, bytes| fs::write(file, bytes).with_context(|| format!("writing {}", file.display()));
        write(&file, SCENE)?;
        write(&paths, PATHS)?;
        let mut scene = LocalScene::new(file);
        scene.options.animation = animation;
        scene.options.editable = editable.split(',').map(str::to_owned).collect();
        let server = LocalServer::start(folder, &scene)?;
        Ok(Self { server, path: format!("{}#walk", paths.display()) })
    }

    #[must_use]
    pub fn url(&self) -> &ServerUrl {
        self.server.url()
    }

    /// Returns a camera path through the scene, as `--path` takes it.
    #[must_use]
    pub fn path(&self) -> &str {
        &self.path
    }
}
