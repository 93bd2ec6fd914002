use std::path::PathBuf;

use gnomon_scene::SceneError;
use thiserror::Error;

use crate::visibility::engine::EngineError;
pub use crate::{
    admission::tokens::TokenError, config::ConfigError, net::certificate::CertificateError, net::endpoint::ListenError,
    operate::admin::AdminError, web::WebError,
};

#[derive(Debug, Error)]
pub enum StartError {
    #[error(transparent)]
    Admin(#[from] AdminError),
    #[error("configuration: {0}")]
    Config(#[from] ConfigError),
    #[error("no scene: pass --scene FILE (.gltf or .glb)")]
    NoScene,
    #[error("scene {path}: {reason}")]
    Scene { path: PathBuf, reason: Box<SceneError> },
    #[error("scene {path} cannot be packed: {reason}")]
    Pack { path: PathBuf, reason: String },
    #[error(transparent)]
    Tokens(#[from] TokenError),
    #[error(transparent)]
    Certificate(#[from] CertificateError),
    #[error(transparent)]
    Listen(#[from] ListenError),
    #[error(transparent)]
    Web(#[from] WebError),
    #[error("tracing: {0}")]
    Engine(Box<EngineError>),
    #[error("start-up failed: {0}")]
    Broken(String),
}
