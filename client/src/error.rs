//! Errors of a run. Every message says what to do, or gives the numbers that show the cause.

use std::{path::PathBuf, time::Duration};

use gnomon_client_core::mask::world::WorldError;
use gnomon_protocol::{ids::FrameNumber, mask::ShapeError, message::Refusal};
use gnomon_scene::{PackError, SceneError};
use gnomon_shaders::gpu::GpuError;
use gnomon_transport::control::ControlError;
use thiserror::Error;

use crate::{
    app::local_server::LocalServerError,
    app::servers::{PinError, hex},
    camera_path::PathError,
    environment::EnvironmentError,
    link::scene_cache::SceneFetchError,
    link::url::ServerUrl,
    render::RenderError,
    stop::Cause,
};

#[derive(Debug, Error)]
pub enum ClientError {
    #[error("--size: {0}")]
    Size(#[from] ShapeError),
    /// A setting is out of range.
    #[error("--{option}: {reason}")]
    Option { option: &'static str, reason: String },
    #[error(transparent)]
    Path(#[from] PathError),
    #[error(transparent)]
    Environment(#[from] EnvironmentError),
    #[error(transparent)]
    Scene(#[from] SceneError),
    #[error("{path}, line {line}: {reason}")]
    Edits { path: PathBuf, line: usize, reason: String },
    #[error(transparent)]
    World(#[from] WorldError),
    #[error(
        "no answer from {url} within {} s: is gnomon-server running there, and does UDP reach it?",
        after.as_secs_f64()
    )]
    Unreachable { url: Box<ServerUrl>, after: Duration },
    #[error("cannot connect to {url}: {reason}")]
    Connect { url: Box<ServerUrl>, reason: String },
    /// The server's certificate is not the URL's.
    #[error("{0} has another certificate than this URL's: use the URL that the server printed when it started")]
    Certificate(Box<ServerUrl>),
    /// Nobody has vouched for a server that a token would go to.
    #[error(
        "first visit to {url}: no token goes to a server that nobody has vouched for. Compare its certificate with the \
         line that the server printed, then pass ?cert={} or --trust-first-use",
        hex(digest)
    )]
    FirstVisit { url: Box<ServerUrl>, digest: [u8; 32] },
    #[error("the certificate of {url} cannot be pinned, pass its ?cert=SHA256 instead: {source}")]
    NotPinned { url: Box<ServerUrl>, source: PinError },
    /// The server's certificate is not the one pinned on the first visit.
    #[error(
        "{0} has another certificate than on the first visit: use the URL that the server printed, if it is still that \
         server"
    )]
    CertificateChanged(Box<ServerUrl>),
    /// The two ends have no protocol in common.
    #[error("{0} speaks another version of the protocol than this client: install matching versions")]
    OtherVersion(Box<ServerUrl>),
    #[error(transparent)]
    Refused(Refusal),
    #[error("the connection to {url} broke off: {source}")]
    Conversation { url: Box<ServerUrl>, source: ControlError },
    #[error("{url} violates the protocol: {reason}")]
    Protocol { url: Box<ServerUrl>, reason: String },
    #[error(transparent)]
    Fetch(#[from] SceneFetchError),
    #[error("the server's scene cannot be used: {0}")]
    Unpack(#[from] PackError),
    #[error(transparent)]
    Gpu(#[from] GpuError),
    #[error("no window: {0}; --headless draws into files instead")]
    Window(String),
    #[error(transparent)]
    Render(#[from] RenderError),
    #[error("the local server: {0}")]
    LocalServer(#[from] LocalServerError),
    #[error("cannot write {}: {source}", path.display())]
    Write { path: PathBuf, source: std::io::Error },
    /// The run was asked to end.
    #[error(transparent)]
    Stopped(#[from] Cause),
    /// The run has drawn its frames, the last ones without the server.
    #[error("the run ended without its server: {0}")]
    EndedAlone(String),
    /// The session ended before all frames were drawn.
    #[error("the session ended after {rendered} of {wanted} frames: {reason}")]
    Ended { rendered: u32, wanted: u32, reason: String },
    /// A frame's mask did not arrive (`--wait`).
    #[error(
        "no visibility for frame {frame} within {} s after {asked} requests: the path to the server loses too much",
        after.as_secs()
    )]
    NoVisibility { frame: FrameNumber, after: Duration, asked: u32 },
    /// The operating system refuses a thread or a runtime.
    #[error("cannot start: {0}")]
    System(#[from] std::io::Error),
}
