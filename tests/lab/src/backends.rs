//! The back ends under test, by name: one line here brings another before every test and report that judges them all.

use anyhow::Result;
use gnomon_protocol::mask::{Mask, MaskShape};
use gnomon_scene::{Scene, camera::Camera};
use gnomon_server::visibility::{
    TraceCost,
    backend::{BackendError, compute::ComputeBackend, cpu::CpuBackend, ray_query},
};

/// A back end that masks can be traced with.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum BackendName {
    /// Native, on the processor.
    Cpu,
    /// Kernels in WGSL, on any adapter.
    Compute,
    /// The same kernels with the adapter's own ray queries, which few adapters have.
    RayQuery,
}

/// An open back end: traces what a camera sees into a mask of its size.
pub type Trace = Box<dyn FnMut(&Camera, &mut Mask) -> Result<TraceCost>>;

impl BackendName {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Cpu, Self::Compute, Self::RayQuery];
    /// Those that every machine has, be it with a software adapter.
    pub const EVERYWHERE: [Self; 2] = [Self::Cpu, Self::Compute];

    /// As on the server's command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Cpu => "cpu",
            Self::Compute => "compute",
            Self::RayQuery => "ray-query",
        }
    }

    /// Brings the scene to the back end. Software adapters count.
    ///
    /// # Errors
    /// When the scene is refused, or there is no adapter.
    pub fn open(self, scene: &Scene) -> Result<Trace> {
        let mut backend = match self {
            Self::Cpu => {
                let backend = CpuBackend::new(scene, None)?;
                return Ok(Box::new(move |camera, mask| Ok(backend.trace(camera, mask))));
            }
            Self::Compute => ComputeBackend::open(scene, None, true)?,
            Self::RayQuery => ray_query::open(scene, None, true)?,
        };
        Ok(Box::new(move |camera, mask| Ok(backend.trace(camera, mask)?)))
    }

    /// Whether an adapter here, software or not, has what the back end needs.
    ///
    /// # Errors
    /// When that cannot be found out.
    pub fn is_here(self, scene: &Scene) -> Result<bool> {
        if self != Self::RayQuery {
            return Ok(true);
        }
        match ray_query::open(scene, None, true) {
            Ok(_) => Ok(true),
            Err(BackendError::Feature { .. } | BackendError::Gpu(_)) => Ok(false),
            Err(error) => Err(error.into()),
        }
    }

    /// One mask of the scene.
    ///
    /// # Errors
    /// As [`Self::open`], or when the mask cannot be traced.
    pub fn mask(self, scene: &Scene, camera: &Camera) -> Result<Mask> {
        let lights = u32::try_from(scene.lights.len())?;
        let mut mask = Mask::new(MaskShape::new(camera.width, camera.height, lights)?);
        self.open(scene)?(camera, &mut mask)?;
        Ok(mask)
    }
}
