//! Back ends under test, by name. Every test and report that judges them all uses this list.

use anyhow::Result;
use gnomon_protocol::mask::{Mask, MaskShape};
use gnomon_scene::{Scene, camera::Camera};
use gnomon_server::visibility::{
    TraceCost,
    backend::{BackendError, compute::ComputeBackend, cpu::CpuBackend, ray_query},
};

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum BackendName {
    /// Native code on the CPU.
    Cpu,
    /// WGSL kernels on any adapter.
    Compute,
    /// The same kernels with hardware ray queries.
    RayQuery,
}

/// Traces a camera's view into a mask of its size.
pub type Trace = Box<dyn FnMut(&Camera, &mut Mask) -> Result<TraceCost>>;
/// Traces a camera's view of the scene at a time in seconds into a mask of its size.
pub type TraceAt = Box<dyn FnMut(&Camera, f64, &mut Mask) -> Result<TraceCost>>;

impl BackendName {
    pub const ALL: [Self; 3] = [Self::Cpu, Self::Compute, Self::RayQuery];
    /// Those that run on every machine, on a software adapter if need be.
    pub const EVERYWHERE: [Self; 2] = [Self::Cpu, Self::Compute];

    /// Name on the server's command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Cpu => "cpu",
            Self::Compute => "compute",
            Self::RayQuery => "ray-query",
        }
    }

    /// Opens the back end for a scene, at time 0. Software adapters count.
    pub fn open(self, scene: &Scene) -> Result<Trace> {
        let mut trace = self.open_at(scene)?;
        Ok(Box::new(move |camera, mask| trace(camera, 0.0, mask)))
    }

    /// Opens the back end for a scene at any time. Software adapters count.
    pub fn open_at(self, scene: &Scene) -> Result<TraceAt> {
        let mut backend = match self {
            Self::Cpu => {
                let backend = CpuBackend::new(scene, None)?;
                return Ok(Box::new(move |camera, time_s, mask| Ok(backend.trace_at(camera, time_s, mask))));
            }
            Self::Compute => ComputeBackend::open(scene, None, true)?,
            Self::RayQuery => ray_query::open(scene, None, true)?,
        };
        Ok(Box::new(move |camera, time_s, mask| Ok(backend.trace_at(camera, time_s, mask)?)))
    }

    /// Returns whether an adapter here, software or not, supports the back end.
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

    pub fn mask(self, scene: &Scene, camera: &Camera) -> Result<Mask> {
        let lights = u32::try_from(scene.lights.len())?;
        let mut mask = Mask::new(MaskShape::new(camera.width, camera.height, lights)?);
        self.open(scene)?(camera, &mut mask)?;
        Ok(mask)
    }
}
