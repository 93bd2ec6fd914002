//! Times the `compute` back end on a scene, stage by stage, and compares its masks with those of the `cpu` back end.
//!
//! `cargo run --release -p gnomon-server --example gpu_times -- SCENE [--lights-from FILE] [--lights 1,4,8] [--size
//! WxH,…] [--from X,Y,Z --to X,Y,Z | --views FROM:TO;…] [--frames N] [--lists where-paid|always|never,…] [--adapter
//! NAME] [--allow-software] [--json FILE]`
//!
//! For each number of lights, size, view and way to use lists it prints: times of the kernels by the device's clock, of
//! the read-back, and of whole frames one at a time; frames per second with a full ring; and the share of relevant bits
//! in which the back ends differ. Ends with an error if that share exceeds `--tolerance`, or if lists change a bit.

mod view;

use std::{
    path::PathBuf,
    time::{Duration, Instant},
};

use anyhow::{Context, Result, ensure};
use clap::Parser;
use glam::DVec3;
use gnomon_protocol::mask::{Mask, MaskShape};
use gnomon_scene::camera::Camera;
use gnomon_server::visibility::{
    RayShares, TraceCost,
    backend::{
        compute::{ComputeBackend, Lists, RING_FRAMES},
        cpu::CpuBackend,
    },
};
use serde::Serialize;

use self::view::{ViewArguments, from_to, size};

/// Traces a scene repeatedly on a graphics adapter and prints the speed.
#[derive(Debug, Parser)]
struct Arguments {
    #[command(flatten)]
    view: ViewArguments,
    /// Numbers of lights: the first N of the scene.
    #[arg(long, value_delimiter = ',', default_values_t = [1, 4, 8])]
    lights: Vec<usize>,
    /// Sizes of the mask.
    #[arg(long, value_delimiter = ',', default_value = "1920x1080", value_parser = size)]
    size: Vec<(u32, u32)>,
    /// Views instead of the one: a position and a point that is looked at each.
    #[arg(long, value_delimiter = ';', value_parser = from_to, allow_hyphen_values = true)]
    views: Vec<(DVec3, DVec3)>,
    /// Frames to time.
    #[arg(long, default_value_t = 50)]
    frames: usize,
    /// When blocks of pixels share lists of triangles: each of these in turn.
    #[arg(long, value_enum, value_delimiter = ',', default_value = "where-paid")]
    lists: Vec<ListsArgument>,
    /// Part of the adapter's name.
    #[arg(long)]
    adapter: Option<String>,
    /// Use a software adapter if there is no other.
    #[arg(long)]
    allow_software: bool,
    /// Do not trace on the processor to compare.
    #[arg(long)]
    no_cpu: bool,
    /// Largest share of the relevant bits in which the back ends may differ.
    #[arg(long, default_value_t = 0.001)]
    tolerance: f64,
    /// Also writes the figures here.
    #[arg(long)]
    json: Option<PathBuf>,
}

#[derive(Debug, Clone, Copy, clap::ValueEnum, Serialize)]
enum ListsArgument {
    WherePaid,
    Always,
    Never,
}

impl From<ListsArgument> for Lists {
    fn from(argument: ListsArgument) -> Self {
        match argument {
            ListsArgument::WherePaid => Self::WherePaid,
            ListsArgument::Always => Self::Always,
            ListsArgument::Never => Self::Never,
        }
    }
}

/// Median and 99th percentile.
#[derive(Debug, Clone, Copy, Serialize)]
struct Spread {
    median: f64,
    p99: f64,
}

/// The figures for one number of lights.
#[derive(Debug, Serialize)]
struct Row {
    lights: usize,
    /// Number of the view, from 0.
    view: usize,
    lists: ListsArgument,
    width: u32,
    height: u32,
    frames: usize,
    primary_ms: Spread,
    shadow_ms: Spread,
    readback_ms: Spread,
    frame_ms: Spread,
    full_ring_frames_per_s: f64,
    primary_mrays_per_s: f64,
    shadow_mrays_per_s: f64,
    /// Share of the primary rays that were tested against lists.
    primary_listed_part: f64,
    shadow_rays: u64,
    /// How the bits of these rays were found, by name.
    shares: [(&'static str, u64); 4],
    differing_bits: u64,
    differing_part: f64,
}

#[derive(Debug, Serialize)]
struct Report {
    scene: String,
    triangles: usize,
    backend: String,
    setup_s: f64,
    rows: Vec<Row>,
}

impl Arguments {
    fn camera(&self, view: usize, (width, height): (u32, u32)) -> Camera {
        match self.views.get(view) {
            Some((from, to)) => self.view.looking((*from, *to), (width, height)),
            None => self.view.camera((width, height)),
        }
    }
}

impl Row {
    #[expect(clippy::cast_precision_loss, reason = "counts far below 2^53")]
    fn print(&self) {
        let both = |spread: Spread| format!("{:.3} ({:.3})", spread.median, spread.p99);
        println!(
            "| {} | {}×{} | {} | {:?} | {} | {} | {} | {} | {:.0} | {:.0} | {:.0} | {:.1} | {} | {} of {} ({:.4} %) |",
            self.lights,
            self.width,
            self.height,
            self.view,
            self.lists,
            both(self.primary_ms),
            both(self.shadow_ms),
            both(self.readback_ms),
            both(self.frame_ms),
            self.full_ring_frames_per_s,
            self.primary_mrays_per_s,
            self.shadow_mrays_per_s,
            100.0 * self.primary_listed_part,
            self.shares
                .map(|(_, rays)| format!("{:.1}", 100.0 * rays as f64 / self.shadow_rays.max(1) as f64))
                .join(", "),
            self.differing_bits,
            self.shadow_rays,
            self.differing_part * 100.0
        );
    }
}

fn spread(costs: &[(TraceCost, f64)], of: impl Fn(&(TraceCost, f64)) -> f64) -> Spread {
    let mut values: Vec<f64> = costs.iter().map(of).collect();
    values.sort_by(f64::total_cmp);
    let last = values.len() - 1;
    Spread { median: values[last / 2], p99: values[last - values.len() / 100] }
}

#[expect(clippy::cast_precision_loss, reason = "counts far below 2^53")]
fn measure(
    (compute, lists): (&mut ComputeBackend, ListsArgument),
    cpu: Option<&CpuBackend>,
    (view, camera): (usize, &Camera),
    (lights, frames): (usize, usize),
) -> Result<(Row, Mask)> {
    let shape = MaskShape::new(camera.width, camera.height, u32::try_from(lights)?)?;
    let mut mask = Mask::new(shape);
    // The first frames raise clocks and load memory.
    for _ in 0..5 {
        compute.trace(camera, &mut mask)?;
    }
    let mut costs = Vec::with_capacity(frames);
    for _ in 0..frames {
        let begin = Instant::now();
        let cost = compute.trace(camera, &mut mask)?;
        costs.push((cost, begin.elapsed().as_secs_f64() * 1e3));
    }

    let begin = Instant::now();
    let mut scratch = Mask::new(shape);
    for frame in 0..frames + RING_FRAMES {
        if frame >= RING_FRAMES {
            while compute.collect(Duration::from_secs(1), &mut scratch)?.is_none() {}
        }
        if frame < frames {
            compute.submit(camera, 0.0, shape)?;
        }
    }
    let full_ring_frames_per_s = frames as f64 / begin.elapsed().as_secs_f64();

    let differing_bits = cpu.map_or(0, |cpu| {
        let mut expected = Mask::new(shape);
        cpu.trace(camera, &mut expected);
        differing(&mask, &expected)
    });

    let (primary_ms, shadow_ms) = (spread(&costs, |c| c.0.primary_ms), spread(&costs, |c| c.0.shadow_ms));
    let (rays, shadow_rays) = (costs[0].0.primary_rays, costs[0].0.shadow_rays);
    let row = Row {
        lights,
        view,
        lists,
        width: camera.width,
        height: camera.height,
        frames,
        primary_ms,
        shadow_ms,
        readback_ms: spread(&costs, |c| c.0.readback_ms),
        frame_ms: spread(&costs, |c| c.1),
        full_ring_frames_per_s,
        primary_mrays_per_s: rays as f64 / primary_ms.median / 1e3,
        shadow_mrays_per_s: shadow_rays as f64 / shadow_ms.median / 1e3,
        primary_listed_part: costs[0].0.primary_listed as f64 / rays as f64,
        shadow_rays,
        shares: std::array::from_fn(|i| (RayShares::NAMES[i], costs[0].0.shares.counts()[i])),
        differing_bits,
        differing_part: differing_bits as f64 / shadow_rays.max(1) as f64,
    };
    Ok((row, mask))
}

fn differing(one: &Mask, other: &Mask) -> u64 {
    one.words().iter().zip(other.words()).map(|(a, b)| u64::from((a ^ b).count_ones())).sum()
}

fn main() -> Result<()> {
    let arguments = Arguments::parse();
    ensure!(arguments.frames > 0, "nothing to time in 0 frames");
    let whole = arguments.view.load(None)?;
    let views = arguments.views.len().max(1);
    let mut report = Report {
        scene: arguments.view.scene.display().to_string(),
        triangles: whole.tracing_triangles().len(),
        backend: String::new(),
        setup_s: 0.0,
        rows: Vec::new(),
    };
    println!(
        "| lights | size | view | lists | primary ms (p99) | shadow ms (p99) | read-back ms (p99) | frame ms (p99) | \
         frames/s, full ring | primary Mray/s | shadow Mray/s | primary listed, % | lit, dark, listed, traced, % | \
         differing |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|---|---|---|");
    for &lights in &arguments.lights {
        let available = whole.lights.len();
        ensure!((1..=available).contains(&lights), "{lights} lights of a scene that has {available}");
        let mut scene = whole.clone();
        scene.lights.truncate(lights);
        let cpu = (!arguments.no_cpu).then(|| CpuBackend::new(&scene, None)).transpose()?;
        let mut ways = Vec::new();
        for &lists in &arguments.lists {
            let begin = Instant::now();
            let (adapter, software) = (arguments.adapter.clone(), arguments.allow_software);
            ways.push((ComputeBackend::open_with_lists(&scene, adapter, software, lists.into())?, lists));
            report.setup_s = begin.elapsed().as_secs_f64();
        }
        for (&size, view) in arguments.size.iter().flat_map(|size| (0..views).map(move |view| (size, view))) {
            let camera = arguments.camera(view, size);
            let mut first: Option<Mask> = None;
            for (compute, lists) in &mut ways {
                report.backend = compute.describe();
                let (row, mask) =
                    measure((compute, *lists), cpu.as_ref(), (view, &camera), (lights, arguments.frames))?;
                row.print();
                report.rows.push(row);
                let changed = differing(first.get_or_insert_with(|| mask.clone()), &mask);
                ensure!(changed == 0, "{changed} bits of one way to use lists are not those of another");
            }
        }
    }
    let json = serde_json::to_string_pretty(&report)?;
    println!("\n{json}");
    if let Some(path) = &arguments.json {
        std::fs::write(path, &json).with_context(|| format!("cannot write {}", path.display()))?;
    }
    let worst = report.rows.iter().map(|row| row.differing_part).fold(0.0, f64::max);
    ensure!(worst <= arguments.tolerance, "{worst} of the bits differ, more than {}", arguments.tolerance);
    Ok(())
}
