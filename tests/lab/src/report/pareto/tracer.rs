//! The server's side of a measurement: a back end with its knobs set, timed and counted.

use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use gnomon_protocol::{
    codec::{CodecId, Encoder, Simplifier},
    mask::{Mask, MaskShape},
};
use gnomon_scene::{Scene, camera::Camera};
use gnomon_server::visibility::backend::{
    BackendError,
    compute::{ComputeBackend, KernelOptions},
    cpu::CpuBackend,
    ray_query,
    sampling::Sampling,
};

/// The back ends, by the names of `--backend`.
pub(super) const BACKENDS: [&str; 3] = ["cpu", "compute", "ray-query"];

enum Kind {
    Cpu(Box<CpuBackend>),
    Device(Box<ComputeBackend>),
}

/// A back end for one scene.
pub(super) struct Tracer {
    kind: Kind,
    lights: u32,
    /// Kept from frame to frame, as sessions do.
    encoder: Encoder,
    body: Vec<u8>,
    simplifier: Simplifier,
    wrong_ppm: u16,
}

/// What a frame took.
#[derive(Debug, Clone, Copy)]
pub(super) struct Traced {
    /// Tracing and encoding, by the wall's clock, in milliseconds.
    pub(super) ms: f64,
    /// Camera rays and shadow rays.
    pub(super) rays: u64,
    /// Of the encoded mask.
    pub(super) bytes: u64,
}

impl Tracer {
    /// Opens a back end. `Ok(None)` when no adapter here has what it needs.
    pub(super) fn open(name: &str, scene: &Scene, options: KernelOptions) -> Result<Option<Self>> {
        let device = |opened: Result<ComputeBackend, BackendError>| match opened {
            Ok(backend) => Ok(Some(Kind::Device(Box::new(backend)))),
            Err(BackendError::Feature { .. }) => Ok(None),
            Err(error) => Err(error),
        };
        let kind = match name {
            "cpu" => Some(Kind::Cpu(Box::new(CpuBackend::new(scene, None)?.with_sampling(options.sampling)))),
            "compute" => device(ComputeBackend::open_with(scene, None, true, options))?,
            "ray-query" => device(ray_query::open_with(scene, None, true, options))?,
            _ => bail!("{name:?} is no back end: {}", BACKENDS.join(", ")),
        };
        let lights = u32::try_from(scene.lights.len()).context("more lights than a mask has")?;
        let encoder = Encoder::new(CodecId::PlanesLz4);
        let simplifier = Simplifier::default();
        Ok(kind.map(|kind| Self { kind, lights, encoder, body: Vec::new(), simplifier, wrong_ppm: 0 }))
    }

    /// Lets so many bits be wrong, in parts of a million.
    pub(super) fn with_wrong_bits(self, wrong_ppm: u16) -> Self {
        Self { wrong_ppm, ..self }
    }

    /// A mask for what `camera` sees.
    pub(super) fn mask_for(&self, camera: &Camera) -> Result<Mask> {
        Ok(Mask::new(MaskShape::new(camera.width, camera.height, self.lights)?))
    }

    /// Traces and encodes one frame.
    pub(super) fn trace(&mut self, camera: &Camera, mask: &mut Mask, codec: CodecId) -> Result<Traced> {
        if self.encoder.codec() != codec {
            self.encoder = Encoder::new(codec);
        }
        let begun = Instant::now();
        let cost = match &mut self.kind {
            Kind::Cpu(backend) => backend.trace(camera, mask),
            Kind::Device(backend) => backend.trace(camera, mask)?,
        };
        self.simplifier.simplify(mask, self.wrong_ppm);
        self.encoder.encode(mask, &mut self.body)?;
        let ms = begun.elapsed().as_secs_f64() * 1e3;
        Ok(Traced { ms, rays: cost.primary_rays + cost.shadow_rays, bytes: self.body.len() as u64 })
    }
}

/// Nodes that the frame's rays visit: by single rays on `compute`, by groups of up to 64 on `cpu`; nobody can say for
/// `ray-query`.
pub(super) fn node_visits(name: &str, scene: &Scene, sampling: Sampling, camera: &Camera) -> Result<Option<u64>> {
    let options = KernelOptions { sampling, count_nodes: true, ..KernelOptions::default() };
    let Some(mut tracer) = (if name == "ray-query" { None } else { Tracer::open(name, scene, options)? }) else {
        return Ok(None);
    };
    let mut mask = tracer.mask_for(camera)?;
    Ok(Some(match &mut tracer.kind {
        Kind::Cpu(backend) => backend.trace_counted(camera, &mut mask).1.iter().map(|work| work.nodes).sum(),
        Kind::Device(backend) => {
            backend.trace(camera, &mut mask)?;
            backend.node_visits()
        }
    }))
}

/// The back end that `auto` takes on this machine.
pub(super) fn automatic(scene: &Scene) -> &'static str {
    match ray_query::open_preferred(scene, None, false) {
        Ok(backend) if backend.describe().starts_with("ray-query") => "ray-query",
        Ok(_) => "compute",
        Err(_) => "cpu",
    }
}

/// When a measurement has enough samples.
#[derive(Debug, Clone, Copy)]
pub(super) struct Patience {
    /// Samples that are enough.
    pub(super) samples: usize,
    /// Time after which one is.
    pub(super) time: Duration,
}

impl Patience {
    /// Calls `sample` again and again, and keeps what it says.
    pub(super) fn repeat<T>(&self, mut sample: impl FnMut(usize) -> Result<T>) -> Result<Vec<T>> {
        let begun = Instant::now();
        let mut samples = Vec::with_capacity(self.samples);
        while samples.is_empty() || (samples.len() < self.samples && begun.elapsed() < self.time) {
            samples.push(sample(samples.len())?);
        }
        Ok(samples)
    }
}
