//! `lab moving-times`: what moving things cost a back end on a device, and whether its masks are still those of `cpu`.

use std::time::{Duration, Instant};

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
    /// `compute` or `ray-query`.
    #[arg(long, value_enum, default_value = "compute")]
    pub backend: BackendName,
    /// Moves things on the processor even where the device can; or on the device even where it is software.
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

struct Device {
    backend: ComputeBackend,
    mask: Mask,
    camera: Camera,
}

/// Medians of one way to show the scene.
struct Times {
    pose_ms: f64,
    kernels_ms: f64,
    frame_ms: f64,
    /// With a full ring.
    frames_per_s: f64,
}

impl Device {
    fn open(options: &MovingTimesOptions, scene: &Scene, camera: Camera) -> Result<Self> {
        let posers = match options.moved_by {
            None => Posers::WherePaid,
            Some(MovedBy::Host) => Posers::Host,
            Some(MovedBy::Device) => Posers::Device,
        };
        let shape = MaskShape::new(camera.width, camera.height, u32::try_from(scene.lights.len())?)?;
        let mut backend = if options.backend == BackendName::RayQuery {
            ray_query::open(scene, None, options.allow_software)?
        } else {
            ComputeBackend::open_with_posers(scene, None, options.allow_software, posers)?
        };
        backend.fit([shape])?;
        Ok(Self { backend, mask: Mask::new(shape), camera })
    }

    fn times(&mut self, frames: u32, time_s: impl Fn(u32) -> f64) -> Result<Times> {
        let mut costs: Vec<(TraceCost, f64)> = Vec::new();
        for frame in 0..frames + WARM_UP {
            let from = Instant::now();
            let cost = self.backend.trace_at(&self.camera, time_s(frame), &mut self.mask)?;
            costs.push((cost, from.elapsed().as_secs_f64() * 1e3));
        }
        let median = |of: fn(&(TraceCost, f64)) -> f64| {
            let mut all: Vec<f64> = costs.iter().skip(WARM_UP as usize).map(of).collect();
            all.sort_by(f64::total_cmp);
            all.get(all.len() / 2).copied().unwrap_or_default()
        };
        let (from, ring) = (Instant::now(), u32::try_from(RING_FRAMES)?);
        for frame in 0..frames + ring {
            if frame >= ring {
                while self.backend.collect(Duration::from_secs(1), &mut self.mask)?.is_none() {}
            }
            if frame < frames {
                self.backend.submit(&self.camera, time_s(frames + frame), self.mask.shape())?;
            }
        }
        Ok(Times {
            pose_ms: median(|(cost, _)| cost.pose_ms),
            kernels_ms: median(|(cost, _)| cost.primary_ms + cost.shadow_ms),
            frame_ms: median(|(_, frame_ms)| *frame_ms),
            frames_per_s: f64::from(frames) / from.elapsed().as_secs_f64(),
        })
    }
}

/// Returns a row for each number of movers: where they stand, and where they move. Errors if masks differ.
pub fn measure(options: &MovingTimesOptions, mut progress: impl FnMut(&str)) -> Result<Table> {
    let (width, height) = options.scene.size;
    let (bare, path) = (options.scene.load_scene()?, options.scene.load_path()?);
    let camera = path.camera(options.at, width, height);
    let mut table = Table::new(
        "movers | triangles | shown | pose ms | kernels ms | frame ms | frames/s | device MB | rays | differing",
    );
    for &movers in &options.movers {
        let moving = movers::with_movers(&bare, movers, options.skinned);
        let standing = moving.still_at(0.0);
        for (how, scene) in [("standing", &standing), ("moving", &moving)] {
            if movers == 0 && how == "moving" {
                continue;
            }
            let mut device = Device::open(options, scene, camera)?;
            let times = device.times(options.scene.frames, |frame| f64::from(frame) * STEP_S)?;
            let cpu = CpuBackend::new(scene, None)?;
            let (mut rays, mut differing, mut expected) = (0, 0, Mask::new(device.mask.shape()));
            for frame in 0..COMPARED {
                let time_s = f64::from(frame) * 1.7;
                device.backend.trace_at(&camera, time_s, &mut device.mask)?;
                rays += cpu.trace_at(&camera, time_s, &mut expected).shadow_rays;
                let words = device.mask.words().iter().zip(expected.words());
                differing += words.map(|(one, other)| u64::from((one ^ other).count_ones())).sum::<u64>();
            }
            let memory = device.backend.memory();
            let bytes = memory.hierarchy_bytes + memory.triangle_bytes + memory.moving_bytes;
            let row = vec![
                movers.to_string(),
                scene.tracing_triangles().len().to_string(),
                how.to_owned(),
                format!("{:.3}", times.pose_ms),
                format!("{:.3}", times.kernels_ms),
                format!("{:.3}", times.frame_ms),
                format!("{:.0}", times.frames_per_s),
                format!("{:.1}", bytes as f64 / 1e6),
                rays.to_string(),
                differing.to_string(),
            ];
            progress(&format!("{}: {}", device.backend.describe(), row.join(" | ")));
            table.rows.push(row);
            let share = differing as f64 / rays.max(1) as f64;
            ensure!(share <= options.tolerance, "{movers} movers, {how}: {share} of the rays' bits differ from cpu's");
        }
    }
    Ok(table)
}
