//! Why a server does not start.

use std::path::PathBuf;

use gnomon_scene::SceneError;
use thiserror::Error;

use crate::visibility::engine::EngineError;
pub use crate::{
    admission::tokens::store::TokenError, config::ConfigError, net::certificate::CertificateError,
    net::endpoint::ListenError, operate::admin::listener::AdminError,
};

/// Why a server does not start.
#[derive(Debug, Error)]
pub enum StartError {
    /// The admin address cannot be used.
    #[error(transparent)]
    Admin(#[from] AdminError),
    /// A value of the configuration is wrong.
    #[error("configuration: {0}")]
    Config(#[from] ConfigError),
    /// No scene was named.
    #[error("no scene: pass --scene FILE (.gltf or .glb)")]
    NoScene,
    /// The scene cannot be loaded.
    #[error("scene {path}: {reason}")]
    Scene {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: Box<SceneError>,
    },
    /// The scene cannot be packed for its journey.
    #[error("scene {path} cannot be packed: {reason}")]
    Pack {
        /// The file.
        path: PathBuf,
        /// Why.
        reason: String,
    },
    /// The token file is of no use.
    #[error(transparent)]
    Tokens(#[from] TokenError),
    /// There is no certificate.
    #[error(transparent)]
    Certificate(#[from] CertificateError),
    /// The address cannot be listened on.
    #[error(transparent)]
    Listen(#[from] ListenError),
    /// Nothing can trace.
    #[error("tracing: {0}")]
    Engine(Box<EngineError>),
    /// A part of the start broke off.
    #[error("the start broke off: {0}")]
    Broken(String),
}
