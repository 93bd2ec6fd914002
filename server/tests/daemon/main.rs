//! In-process servers on free ports, with minimal clients.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

mod admin;
mod admission;
mod client;
mod connections;
mod edits;
mod frames;
mod lab;
mod lying;
mod operator;
mod peer;
mod references;
mod sessions;
mod stopping;
mod web;
mod web_address;
mod web_socket;

pub(crate) const LIGHTS: u32 = 2;

use std::{net::SocketAddr, path::Path, time::Duration};

use gnomon_server::{
    RunningServer, Server,
    config::{Backend, ServerConfig},
};

/// A server on a free port that traces the small scene on the processor, and its folder.
struct Rig {
    server: RunningServer,
    folder: tempfile::TempDir,
}

impl Rig {
    async fn start(change: impl FnOnce(&mut ServerConfig, &Path)) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let mut config = config(folder.path());
        change(&mut config, folder.path());
        let server = Server::start(config).await.unwrap();
        Self { server, folder }
    }

    fn address(&self) -> SocketAddr {
        self.server.local_addr()
    }

    /// Waits until `count` sessions are open.
    async fn sessions(&self, count: usize) {
        soon(async {
            while self.server.sessions() != count {
                tokio::time::sleep(Duration::from_millis(5)).await;
            }
        })
        .await;
    }
}

fn config(folder: &Path) -> ServerConfig {
    ServerConfig {
        scene: Some(gnomon_scene::testing::write_scene(folder).unwrap()),
        listen: "127.0.0.1:0".parse().unwrap(),
        backend: Backend::Cpu,
        threads: std::num::NonZeroUsize::new(1),
        cert_dir: Some(folder.join("cert")),
        drain_ms: 100,
        ..ServerConfig::default()
    }
}

/// Fails a test that hangs. Even slow machines need far less time.
async fn soon<T>(work: impl Future<Output = T>) -> T {
    tokio::time::timeout(Duration::from_secs(60), work).await.expect("still not done after a minute")
}
