//! What traces: kernels on a graphics adapter, with or without its own ray queries, or the processor.

use thiserror::Error;

use gnomon_shaders::gpu::GpuError;

pub mod compute;
pub mod cpu;
pub mod ray_query;
pub mod sampling;

/// Why a back end cannot be had for a scene.
#[derive(Debug, Error)]
pub enum BackendError {
    /// There is no adapter, or it gives no device.
    #[error(transparent)]
    Gpu(#[from] GpuError),
    /// The adapter lacks something that the kernels are written with.
    #[error("adapter {adapter:?} lacks {missing}: trace with another --backend; cpu needs no adapter")]
    Feature {
        /// The adapter's name.
        adapter: String,
        /// What it lacks.
        missing: String,
    },
    /// A part of the scene is larger than what the back end can address.
    #[error("the scene is too large: its {what} takes {bytes} bytes, and {limit} is what {adapter:?} can bind")]
    SceneTooLarge {
        /// The part.
        what: &'static str,
        /// Its size.
        bytes: u64,
        /// The most that fits.
        limit: u64,
        /// The adapter's name.
        adapter: String,
    },
    /// A mask is larger than what the back end can address.
    #[error(
        "{width}×{height} pixels with {lights} lights take {bytes} bytes, and {limit} is what {adapter:?} can bind"
    )]
    PictureTooLarge {
        /// Width in pixels.
        width: u32,
        /// Height in pixels.
        height: u32,
        /// Number of lights.
        lights: u32,
        /// Size of the largest buffer needed.
        bytes: u64,
        /// The most that fits.
        limit: u64,
        /// The adapter's name.
        adapter: String,
    },
    /// A kernel cannot be built, or the device refuses it or a buffer.
    #[error("the device cannot be set up for tracing: {0}")]
    Setup(String),
    /// The device is lost, or it does not answer.
    #[error("the device failed: {0}")]
    Device(String),
    /// The threads cannot be had.
    #[error("cannot start {threads} tracing threads: {reason}")]
    Threads {
        /// Threads asked for.
        threads: usize,
        /// The system's reason.
        reason: String,
    },
    /// More triangles than an index can name.
    #[error("{found} triangles stop rays: the cpu back end traces at most {limit}")]
    Triangles {
        /// Triangles that stop rays.
        found: usize,
        /// The most that fit.
        limit: usize,
    },
    /// A MASK material's picture is not decoded.
    #[error("material {material} tests alpha, but its picture is not decoded")]
    Alpha {
        /// Index of the material.
        material: u32,
    },
}
