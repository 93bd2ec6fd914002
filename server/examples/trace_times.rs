//! Times the `cpu` back end on a scene: million rays per second and core, traversal counts, and the mask's digest.
//!
//! `cargo run --release -p gnomon-server --example trace_times -- SCENE [--lights-from FILE] [--lights N] [--size WxH]
//! [--from X,Y,Z --to X,Y,Z] [--frames N] [--threads 1,2] [--picture FILE.pgm]`
//!
//! Wall-clock times of frames include other programs' use of the core. On a busy machine read the processor times.

mod view;

use std::{num::NonZeroUsize, path::PathBuf};

use anyhow::{Context, Result, ensure};
use clap::Parser;
use gnomon_protocol::mask::{Mask, MaskShape};
use gnomon_server::visibility::backend::cpu::{CpuBackend, TraversalStats};

use self::view::{ViewArguments, size};

/// Traces a scene repeatedly and prints the speed.
#[derive(Debug, Parser)]
struct Arguments {
    #[command(flatten)]
    view: ViewArguments,
    /// Keep the first N lights.
    #[arg(long)]
    lights: Option<u32>,
    /// Size of the mask.
    #[arg(long, default_value = "640x360", value_parser = size)]
    size: (u32, u32),
    /// Frames to time.
    #[arg(long, default_value_t = 25)]
    frames: usize,
    /// Numbers of threads to time.
    #[arg(long, value_delimiter = ',', default_values_t = [1, 2])]
    threads: Vec<usize>,
    /// Writes a picture of the number of lights that reach each pixel.
    #[arg(long)]
    picture: Option<PathBuf>,
}

fn main() -> Result<()> {
    let arguments = Arguments::parse();
    ensure!(arguments.frames > 0, "nothing to time in 0 frames");
    let scene = arguments.view.load(arguments.lights)?;
    let (width, height) = arguments.size;
    let camera = arguments.view.camera(arguments.size);
    let mut mask = Mask::new(MaskShape::new(width, height, u32::try_from(scene.lights.len())?)?);

    for (nth, &threads) in arguments.threads.iter().enumerate() {
        let threads = NonZeroUsize::new(threads).context("0 threads")?;
        let backend = CpuBackend::new(&scene, Some(threads))?;
        println!("{}", backend.describe());
        if nth == 0 {
            let (cost, [primary, shadow]) = backend.trace_counted(&camera, 0.0, &mut mask);
            println!("primary: {}", describe(&primary, cost.primary_rays));
            println!("shadow:  {}", describe(&shadow, cost.shadow_rays));
            let bytes: Vec<u8> = mask.words().iter().flat_map(|word| word.to_le_bytes()).collect();
            println!("mask:    BLAKE3 {}", blake3::hash(&bytes));
        }
        let before_s = processor_s();
        let costs: Vec<_> = (0..arguments.frames).map(|_| backend.trace(&camera, &mut mask)).collect();
        let processor_s = processor_s() - before_s;
        let rate = |rays: u64, ms: f64| rays as f64 / (ms * 1e3 * threads.get() as f64);
        let mut primary: Vec<f64> = costs.iter().map(|cost| rate(cost.primary_rays, cost.primary_ms)).collect();
        let mut shadow: Vec<f64> = costs.iter().map(|cost| rate(cost.shadow_rays, cost.shadow_ms)).collect();
        for (stage, rates, rays) in
            [("primary", &mut primary, costs[0].primary_rays), ("shadow", &mut shadow, costs[0].shadow_rays)]
        {
            rates.sort_by(f64::total_cmp);
            println!(
                "{threads} threads, {stage}: {rays} rays, Mray/s and core: best {:.2}, median {:.2}, worst {:.2}",
                rates[rates.len() - 1],
                rates[rates.len() / 2],
                rates[0],
            );
        }
        if processor_s > 0.0 {
            // Wall-clock time gives the stages' shares of the processor's time: interruptions affect both alike.
            let [primary_ms, shadow_ms] =
                [costs.iter().map(|cost| cost.primary_ms).sum::<f64>(), costs.iter().map(|cost| cost.shadow_ms).sum()];
            let frames = arguments.frames as f64;
            let rate = |rays: u64, part_ms: f64| {
                rays as f64 * frames / (processor_s * 1e6 * part_ms / (primary_ms + shadow_ms))
            };
            println!(
                "{threads} threads, by processor time: primary {:.2}, shadow {:.2} Mray/s and core",
                rate(costs[0].primary_rays, primary_ms),
                rate(costs[0].shadow_rays, shadow_ms),
            );
        }
    }
    if let Some(path) = &arguments.picture {
        let mut bytes = format!("P5 {width} {height} 255\n").into_bytes();
        let lights = mask.shape().lights();
        for (y, x) in (0..height).flat_map(|y| (0..width).map(move |x| (y, x))) {
            let reached = (0..lights).filter(|&light| mask.get(light, x, y)).count();
            bytes.push(u8::try_from(reached * 255 / lights as usize)?);
        }
        std::fs::write(path, bytes).with_context(|| format!("cannot write {}", path.display()))?;
    }
    Ok(())
}

/// Processor time of this process in seconds; 0 where the system does not report it (Linux does).
fn processor_s() -> f64 {
    let Ok(tasks) = std::fs::read_dir("/proc/self/task") else { return 0.0 };
    let nanoseconds = |task: std::io::Result<std::fs::DirEntry>| -> Option<f64> {
        let text = std::fs::read_to_string(task.ok()?.path().join("schedstat")).ok()?;
        text.split_whitespace().next()?.parse().ok()
    };
    tasks.filter_map(nanoseconds).sum::<f64>() / 1e9
}

fn describe(stats: &TraversalStats, rays: u64) -> String {
    let rays = rays.max(1) as f64;
    let per_group = |count: u64| count as f64 / stats.groups.max(1) as f64;
    format!(
        "{:.1} rays a group; a group visits {:.1} nodes and {:.1} leaves of {:.1} triangles, of which it tests {:.1}; \
         a ray: {:.2} packet tests, {:.2} of them inside",
        rays / stats.groups.max(1) as f64,
        per_group(stats.nodes),
        per_group(stats.leaves),
        stats.triangles as f64 / stats.leaves.max(1) as f64,
        per_group(stats.tested_triangles),
        stats.packet_tests as f64 * 8.0 / rays,
        stats.candidates as f64 * 8.0 / rays,
    )
}
