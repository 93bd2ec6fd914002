//! The `compute` back end: WGSL kernels on any graphics adapter that has compute shaders.

mod acceleration;
mod backend;
mod enlarge;
mod frame;
mod geometry;
mod kernels;
mod limit;
mod movers;
mod posing;
mod refit;
mod regions;
mod ring;
mod submission;
#[cfg(test)]
mod tests;
mod timing;

pub(super) use self::kernels::{KernelOptions, Traversal};
pub use self::{
    backend::{ComputeBackend, DeviceMemory},
    kernels::{Lists, Posers},
    limit::PictureLimit,
    ring::{RING_FRAMES, SLOTS},
    submission::PartialSubmission,
};
