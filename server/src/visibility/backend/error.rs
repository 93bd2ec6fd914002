//! Why a back end cannot trace.

use gnomon_shaders::gpu::GpuError;
use thiserror::Error;

#[derive(Debug, Error)]
pub enum BackendError {
    /// There is no adapter, or it provides no device.
    #[error(transparent)]
    Gpu(#[from] GpuError),
    /// The adapter lacks a feature or a limit that the kernels need.
    #[error("adapter {adapter:?} lacks {missing}: trace with another --backend; cpu needs no adapter")]
    Feature { adapter: String, missing: String },
    /// A buffer of the scene exceeds the adapter's limit.
    #[error("the scene is too large: its {what} takes {bytes} bytes, and {adapter:?} can bind {limit}")]
    SceneTooLarge { what: &'static str, bytes: u64, limit: u64, adapter: String },
    /// The largest buffer of a mask exceeds the adapter's limit.
    #[error("{width}×{height} pixels with {lights} lights take {bytes} bytes, and {adapter:?} can bind {limit}")]
    PictureTooLarge { width: u32, height: u32, lights: u32, bytes: u64, limit: u64, adapter: String },
    /// A kernel cannot be built, or the device refuses it or a buffer.
    #[error("the device cannot be set up for tracing: {0}")]
    Setup(String),
    /// The device is lost, or does not answer.
    #[error("the device failed: {0}")]
    Device(String),
    #[error("cannot start {threads} tracing threads: {reason}")]
    Threads { threads: usize, reason: String },
    #[error("{found} triangles stop rays: the cpu back end traces at most {limit}")]
    Triangles { found: usize, limit: usize },
    /// The picture of a MASK material is not decoded. `material` is its index.
    #[error("material {material} tests alpha, but its picture is not decoded")]
    Alpha { material: u32 },
}
