use gnomon_shaders::splice::SpliceError;
use thiserror::Error;

/// Why a frame cannot be drawn.
#[derive(Debug, Error)]
pub enum RenderError {
    /// The scene or the picture exceeds a limit of the adapter, in bytes or pixels.
    #[error("the graphics adapter allows {limit} for {what}, but {needed} are needed")]
    TooLarge { what: &'static str, needed: u64, limit: u64 },
    #[error("the graphics adapter failed: {0}")]
    Device(String),
    #[error(transparent)]
    Shader(#[from] SpliceError),
}
