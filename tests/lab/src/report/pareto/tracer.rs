//! The server's side of a measurement: a back end, timed and counted.

use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use gnomon_protocol::{
    codec::{CodecId, EncodedFrame, Encoder, Simplifier},
    mask::{Mask, MaskShape},
};
use gnomon_scene::{Scene, camera::Camera};
use gnomon_server::visibility::backend::{BackendError, compute::ComputeBackend, cpu::CpuBackend, ray_query};

/// The back ends, by the names of `--backend`.
pub(super) const BACKENDS: [&str; 3] = ["cpu", "compute", "ray-query"];

enum Kind {
    Cpu(Box<CpuBackend>),
    Device(Box<ComputeBackend>),
}

pub(super) struct Tracer {
    kind: Kind,
    lights: u32,
    /// Kept from frame to frame, as sessions do.
    encoder: Encoder,
    body: EncodedFrame,
    simplifier: Simplifier,
    wrong_ppm: u16,
}

#[derive(Debug, Clone, Copy)]
pub(super) struct Traced {
    /// Wall-clock time of tracing and encoding, in milliseconds.
    pub(super) ms: f64,
    /// Camera rays and shadow rays.
    pub(super) rays: u64,
    pub(super) bytes: u64,
}

impl Tracer {
    /// Opens a back end. `Ok(None)` if no adapter has what it needs.
    pub(super) fn open(name: &str, scene: &Scene) -> Result<Option<Self>> {
        let device = |opened: Result<ComputeBackend, BackendError>| match opened {
            Ok(backend) => Ok(Some(Kind::Device(Box::new(backend)))),
            Err(BackendError::Feature { .. }) => Ok(None),
            Err(error) => Err(error),
        };
        let kind = match name {
            "cpu" => Some(Kind::Cpu(Box::new(CpuBackend::new(scene, None)?))),
            "compute" => device(ComputeBackend::open(scene, None, true))?,
            "ray-query" => device(ray_query::open(scene, None, true))?,
            _ => bail!("{name:?} is no back end: {}", BACKENDS.join(", ")),
        };
        kind.map(|kind| Self::new(kind, scene)).transpose()
    }

    /// Opens `compute` with another offset of shadow rays, in rounding units.
    pub(super) fn with_offset(scene: &Scene, roundings: u16) -> Result<Self> {
        Self::new(Kind::Device(Box::new(ComputeBackend::open_with_offset(scene, None, true, roundings)?)), scene)
    }

    fn new(kind: Kind, scene: &Scene) -> Result<Self> {
        let lights = u32::try_from(scene.lights.len()).context("more lights than a mask has")?;
        let (encoder, simplifier) = (Encoder::new(CodecId::PlanesLz4), Simplifier::default());
        Ok(Self { kind, lights, encoder, body: EncodedFrame::default(), simplifier, wrong_ppm: 0 })
    }

    pub(super) fn with_wrong_bits(self, wrong_ppm: u16) -> Self {
        Self { wrong_ppm, ..self }
    }

    pub(super) fn mask_for(&self, camera: &Camera) -> Result<Mask> {
        Ok(Mask::new(MaskShape::new(camera.width, camera.height, self.lights)?))
    }

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

/// Nodes that the frame's rays visit in groups of up to 64 on `cpu`. The other back ends do not count them.
pub(super) fn node_visits(name: &str, scene: &Scene, camera: &Camera) -> Result<Option<u64>> {
    if name != "cpu" {
        return Ok(None);
    }
    let mut mask = Mask::new(MaskShape::new(camera.width, camera.height, u32::try_from(scene.lights.len())?)?);
    let (_, stats) = CpuBackend::new(scene, None)?.trace_counted(camera, 0.0, &mut mask);
    Ok(Some(stats.iter().map(|stats| stats.nodes).sum()))
}

/// The back end that `auto` takes on this machine.
pub(super) fn automatic(scene: &Scene) -> &'static str {
    match ray_query::open_preferred(scene, None, false) {
        Ok(backend) if backend.describe().starts_with("ray-query") => "ray-query",
        Ok(_) => "compute",
        Err(_) => "cpu",
    }
}

#[derive(Debug, Clone, Copy)]
pub(super) struct Patience {
    pub(super) samples: usize,
    /// Time after which one sample is enough.
    pub(super) time: Duration,
}

impl Patience {
    pub(super) fn repeat<T>(&self, mut sample: impl FnMut(usize) -> Result<T>) -> Result<Vec<T>> {
        let begun = Instant::now();
        let mut samples = Vec::with_capacity(self.samples);
        while samples.is_empty() || (samples.len() < self.samples && begun.elapsed() < self.time) {
            samples.push(sample(samples.len())?);
        }
        Ok(samples)
    }
}
