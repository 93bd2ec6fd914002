//! Why a run ended without all of its pictures. Every text says what to do, or has the numbers that tell.

use std::{path::PathBuf, time::Duration};

use gnomon_protocol::{ids::FrameNumber, mask::ShapeError, message::Refusal};
use gnomon_scene::{PackError, SceneError};
use gnomon_shaders::gpu::GpuError;
use gnomon_transport::control::ControlError;
use thiserror::Error;

use crate::{
    app::local_server::LocalServerError, camera_path::PathError, link::scene_cache::SceneFetchError,
    link::url::ServerUrl, render::RenderError,
};

/// Why a run failed.
#[derive(Debug, Error)]
pub enum ClientError {
    /// The size is not to be had.
    #[error("--size: {0}")]
    Size(#[from] ShapeError),
    /// A number of the command line or configuration is out of range.
    #[error("--{option}: {reason}")]
    Option {
        /// The option's name.
        option: &'static str,
        /// What is wrong with its value.
        reason: String,
    },
    /// The camera path is not to be had.
    #[error(transparent)]
    Path(#[from] PathError),
    /// The local scene is not to be had.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// The server does not answer.
    #[error("no answer from {url} within {} s: is gnomon-server running there, and does UDP reach it?", after.as_secs_f64())]
    Unreachable {
        /// The server.
        url: Box<ServerUrl>,
        /// How long it was waited for.
        after: Duration,
    },
    /// The server cannot be connected to.
    #[error("cannot connect to {url}: {reason}")]
    Connect {
        /// The server.
        url: Box<ServerUrl>,
        /// Why not.
        reason: String,
    },
    /// The server has another certificate than the URL says.
    #[error("{0} has another certificate than this URL's: use the URL that the server printed when it started")]
    Certificate(Box<ServerUrl>),
    /// The server has another certificate than when this client came first.
    #[error(
        "{0} has another certificate than on the first visit: use the URL that the server printed, if it is still that server"
    )]
    CertificateChanged(Box<ServerUrl>),
    /// The server does not admit this client.
    #[error(transparent)]
    Refused(Refusal),
    /// The control conversation broke off.
    #[error("the server at {url} broke off: {source}")]
    Conversation {
        /// The server.
        url: Box<ServerUrl>,
        /// Why.
        source: ControlError,
    },
    /// The server said something that it must not say now.
    #[error("the server at {url} does not keep to the protocol: {reason}")]
    Protocol {
        /// The server.
        url: Box<ServerUrl>,
        /// What it said.
        reason: String,
    },
    /// The scene did not come, or not in one piece.
    #[error(transparent)]
    Fetch(#[from] SceneFetchError),
    /// The server's scene is not what it should be.
    #[error("the server's scene cannot be used: {0}")]
    Unpack(#[from] PackError),
    /// There is no graphics adapter.
    #[error(transparent)]
    Gpu(#[from] GpuError),
    /// There can be no window.
    #[error("no window: {0}; --headless draws into files instead")]
    Window(String),
    /// The picture cannot be drawn.
    #[error(transparent)]
    Render(#[from] RenderError),
    /// There is no local server.
    #[error("the local server: {0}")]
    LocalServer(#[from] LocalServerError),
    /// A result cannot be written.
    #[error("cannot write {}: {source}", path.display())]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// Why not.
        source: std::io::Error,
    },
    /// The session ended before all frames were drawn.
    #[error("the session ended after {rendered} of {wanted} frames: {reason}")]
    Ended {
        /// Frames drawn.
        rendered: u32,
        /// Frames wanted.
        wanted: u32,
        /// Why it ended.
        reason: String,
    },
    /// A frame's visibility did not come.
    #[error("no visibility for frame {frame} within {} s, asked for {asked} times: the path to the server loses too much", after.as_secs())]
    NoVisibility {
        /// The frame.
        frame: FrameNumber,
        /// How long it was waited for.
        after: Duration,
        /// How often its pose was sent.
        asked: u32,
    },
    /// The operating system refuses something that every run needs.
    #[error("cannot start: {0}")]
    System(#[from] std::io::Error),
}
