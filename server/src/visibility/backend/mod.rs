//! The back ends that trace masks: kernels on a graphics adapter, with or without ray queries, or the processor.

pub mod compute;
pub mod cpu;
mod error;
pub mod ray_query;

pub use self::error::BackendError;
