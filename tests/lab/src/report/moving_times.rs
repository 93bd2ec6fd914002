//! `lab moving-times`: what moving things cost a back end, and whether its masks are those that `cpu` traces of the
//! scene when it stands still then.

use std::{
    num::NonZeroUsize,
    time::{Duration, Instant},
};

use anyhow::{Result, ensure};
use gnomon_protocol::mask::{Mask, MaskShape};
use gnomon_scene::{Scene, camera::Camera};
use gnomon_server::visibility::{
    TraceCost,
    backend::{
        compute::{ComputeBackend, Posers, RING_FRAMES},
        cpu::CpuBackend,
        ray_query,
    },
};

use super::{scene_args::SceneArgs, table::Table};
use crate::{backends::BackendName, scenes::movers};

#[derive(Debug, Clone, clap::Args)]
pub struct MovingTimesOptions {
    /// Scene, path and size.
    #[command(flatten)]
    pub scene: SceneArgs,
    /// Numbers of movers, each of 1,000 triangles.
    #[arg(long, value_delimiter = ',', default_value = "0,1,30,300")]
    pub movers: Vec<u32>,
    /// Bends them by a skin: their 502 vertices follow four joints each.
    #[arg(long)]
    pub skinned: bool,
    /// The back end.
    #[arg(long, value_enum, default_value = "compute")]
    pub backend: BackendName,
    /// Threads of `cpu` [default: one for each processor].
    #[arg(long)]
    pub threads: Option<NonZeroUsize>,
    /// `compute` alone: moves things on the processor even where the device can, or on the device even where it is
    /// software.
    #[arg(long, value_enum)]
    pub moved_by: Option<MovedBy>,
    /// Time on the path, in seconds.
    #[arg(long, default_value_t = 0.0)]
    pub at: f64,
    /// Use a software adapter if there is no other.
    #[arg(long)]
    pub allow_software: bool,
    /// Largest share of the shadow rays whose bits may differ from those of `cpu`.
    #[arg(long, default_value_t = 0.0001)]
    pub tolerance: f64,
}

/// What moves things, on `compute`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum MovedBy {
    Host,
    Device,
}

/// Steps of the scene's time between frames, in seconds.
const STEP_S: f64 = 1.0 / 60.0;

/// Frames before those that count: they raise clocks and load memory.
const WARM_UP: u32 = 10;

/// Frames compared with `cpu`.
const COMPARED: u32 = 3;

enum Tracer {
    Device(Box<ComputeBackend>),
    Cpu(Box<CpuBackend>),
}

struct Bench {
    tracer: Tracer,
    mask: Mask,
    camera: Camera,
}

/// Medians of one way to show the scene.
struct Times {
    pose_ms: f64,
    rays_ms: f64,
    frame_ms: f64,
    /// With a full ring; on `cpu` one after the other.
    frames_per_s: f64,
}

impl Tracer {
    fn open(options: &MovingTimesOptions, scene: &Scene, shape: MaskShape) -> Result<Self> {
        let posers = match options.moved_by {
            None => Posers::WherePaid,
            Some(MovedBy::Host) => Posers::Host,
            Some(MovedBy::Device) => Posers::Device,
        };
        let mut backend = match options.backend {
            BackendName::Cpu => return Ok(Self::Cpu(Box::new(CpuBackend::new(scene, options.threads)?))),
            BackendName::Compute => ComputeBackend::open_with_posers(scene, None, options.allow_software, posers)?,
            BackendName::RayQuery => ray_query::open(scene, None, options.allow_software)?,
        };
        backend.fit([shape])?;
        Ok(Self::Device(Box::new(backend)))
    }

    fn describe(&self) -> String {
        match self {
            Self::Device(backend) => backend.describe(),
            Self::Cpu(backend) => backend.describe(),
        }
    }

    fn memory_bytes(&self) -> u64 {
        match self {
            Self::Device(backend) => {
                let memory = backend.memory();
                memory.hierarchy_bytes + memory.triangle_bytes + memory.moving_bytes
            }
            Self::Cpu(backend) => backend.memory_bytes() as u64,
        }
    }

    fn trace(&mut self, camera: &Camera, time_s: f64, mask: &mut Mask) -> Result<TraceCost> {
        match self {
            Self::Device(backend) => Ok(backend.trace_at(camera, time_s, mask)?),
            Self::Cpu(backend) => Ok(backend.trace_at(camera, time_s, mask)),
        }
    }

    /// Traces frames as fast as it can.
    fn trace_all(&mut self, camera: &Camera, times_s: impl Iterator<Item = f64>, mask: &mut Mask) -> Result<()> {
        let mut in_flight = 0;
        for time_s in times_s {
            match self {
                Self::Cpu(backend) => drop(backend.trace_at(camera, time_s, mask)),
                Self::Device(backend) => {
                    if in_flight == RING_FRAMES {
                        collect(backend, mask)?;
                        in_flight -= 1;
                    }
                    backend.submit(camera, time_s, mask.shape())?;
                    in_flight += 1;
                }
            }
        }
        if let Self::Device(backend) = self {
            (0..in_flight).try_for_each(|_| collect(backend, mask))?;
        }
        Ok(())
    }
}

fn collect(backend: &mut ComputeBackend, mask: &mut Mask) -> Result<()> {
    while backend.collect(Duration::from_secs(1), mask)?.is_none() {}
    Ok(())
}

impl Bench {
    fn open(options: &MovingTimesOptions, scene: &Scene, camera: Camera) -> Result<Self> {
        let shape = MaskShape::new(camera.width, camera.height, u32::try_from(scene.lights.len())?)?;
        Ok(Self { tracer: Tracer::open(options, scene, shape)?, mask: Mask::new(shape), camera })
    }

    fn times(&mut self, frames: u32, time_s: impl Fn(u32) -> f64) -> Result<Times> {
        let mut costs: Vec<(TraceCost, f64)> = Vec::new();
        for frame in 0..frames + WARM_UP {
            let from = Instant::now();
            let cost = self.tracer.trace(&self.camera, time_s(frame), &mut self.mask)?;
            costs.push((cost, from.elapsed().as_secs_f64() * 1e3));
        }
        let median = |of: fn(&(TraceCost, f64)) -> f64| {
            let mut all: Vec<f64> = costs.iter().skip(WARM_UP as usize).map(of).collect();
            all.sort_by(f64::total_cmp);
            all.get(all.len() / 2).copied().unwrap_or_default()
        };
        let from = Instant::now();
        self.tracer.trace_all(&self.camera, (frames..2 * frames).map(time_s), &mut self.mask)?;
        Ok(Times {
            pose_ms: median(|(cost, _)| cost.pose_ms),
            rays_ms: median(|(cost, _)| cost.primary_ms + cost.shadow_ms),
            frame_ms: median(|(_, frame_ms)| *frame_ms),
            frames_per_s: f64::from(frames) / from.elapsed().as_secs_f64(),
        })
    }
}

/// Returns a row for each number of movers: where they stand, and where they move. Errors if masks differ.
pub fn measure(options: &MovingTimesOptions, mut progress: impl FnMut(&str)) -> Result<Table> {
    let has_no_choice = options.moved_by.is_some() && options.backend != BackendName::Compute;
    ensure!(!has_no_choice, "--moved-by is for compute: the host moves things for all other back ends");
    let (width, height) = options.scene.size;
    let (bare, path) = (options.scene.load_scene()?, options.scene.load_path()?);
    let camera = path.camera(options.at, width, height);
    let mut table =
        Table::new("movers | triangles | shown | pose ms | rays ms | frame ms | frames/s | MB | rays | differing");
    for &movers in &options.movers {
        let moving = movers::with_movers(&bare, movers, options.skinned);
        let standing = moving.still_at(0.0);
        for (how, scene) in [("standing", &standing), ("moving", &moving)] {
            if movers == 0 && how == "moving" {
                continue;
            }
            let mut bench = Bench::open(options, scene, camera)?;
            let times = bench.times(options.scene.frames, |frame| f64::from(frame) * STEP_S)?;
            let (mut rays, mut differing, mut expected) = (0, 0, Mask::new(bench.mask.shape()));
            for frame in 0..COMPARED {
                let time_s = f64::from(frame) * 1.7;
                bench.tracer.trace(&camera, time_s, &mut bench.mask)?;
                rays += CpuBackend::new(&scene.still_at(time_s), None)?.trace(&camera, &mut expected).shadow_rays;
                let words = bench.mask.words().iter().zip(expected.words());
                differing += words.map(|(one, other)| u64::from((one ^ other).count_ones())).sum::<u64>();
            }
            let row = vec![
                movers.to_string(),
                scene.tracing_triangles().len().to_string(),
                how.to_owned(),
                format!("{:.3}", times.pose_ms),
                format!("{:.3}", times.rays_ms),
                format!("{:.3}", times.frame_ms),
                format!("{:.0}", times.frames_per_s),
                format!("{:.1}", bench.tracer.memory_bytes() as f64 / 1e6),
                rays.to_string(),
                differing.to_string(),
            ];
            progress(&format!("{}: {}", bench.tracer.describe(), row.join(" | ")));
            table.rows.push(row);
            let share = differing as f64 / rays.max(1) as f64;
            ensure!(
                share <= options.tolerance,
                "{movers} movers, {how}: {share} of the rays' bits differ from those of the scene standing"
            );
        }
    }
    Ok(table)
}
