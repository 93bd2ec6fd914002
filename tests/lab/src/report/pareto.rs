//! Speed against error over real scenes, at every setting that trades one for the other.
//!
//! The rows of the group `tracing` are measured on masks for the frame that shows them: the back end, which also
//! decides whether nodes are compressed (`compute`) or in full precision (`cpu`); the resolution; the offset of shadow
//! rays; the codec; how often dim lights are traced. `prediction` varies the mask's lag and the client's predictor.
//! Milliseconds are the time that a frame waits for its visibility: tracing and encoding, less the allowed lag.
//! `half-mask` is a mask of half the size, which the client's predictor spreads over the picture. `lossy` allows wrong
//! bits so that the codec has less to code.

mod front;
mod judge;
mod measure;
mod row;
mod tracer;
mod viewer;

use std::path::PathBuf;

use anyhow::{Context, Result, ensure};
use gnomon_client::camera_path::{CameraPath, PathSpec};
use gnomon_scene::{LoadOptions, Scene};

use self::{
    front::{Trade, on_front},
    measure::Bench,
    row::{Group, Row},
    tracer::BACKENDS,
};
use super::{
    plot::{Axis, Better, Front, Plot, Series},
    scene_args::size,
    table::Table,
};

#[derive(Debug, Clone, clap::Args)]
pub struct ParetoOptions {
    /// Folder of the six real scenes.
    #[arg(long, env = "GNOMON_SCENES")]
    pub scenes: PathBuf,
    /// Scenes, by their folders' names.
    #[arg(
        long,
        value_delimiter = ',',
        default_value = "sponza,modern-hall,grey-white-room,pink-room-partial,breakfast-room,sponza-dabrovic"
    )]
    pub only: Vec<String>,
    /// Back ends. On software Vulkan ray-query needs VK_DRIVER_FILES=$(deploy/ray-query-driver).
    #[arg(long, value_delimiter = ',', default_value = "cpu,compute,ray-query")]
    pub backends: Vec<String>,
    /// Size of the picture, WIDTHxHEIGHT.
    #[arg(long, value_parser = size, default_value = "320x180")]
    pub size: (u32, u32),
    /// How often each view is traced.
    #[arg(long, default_value_t = 21)]
    pub samples: usize,
    /// Seconds after which a measurement stops early.
    #[arg(long, default_value_t = 5.0)]
    pub seconds: f64,
    /// Folder for tables and plots.
    #[arg(long, default_value = "target/lab")]
    pub out: PathBuf,
}

/// Measures all settings and writes `pareto.csv` and a plot per scene. Reports steps, and defaults off the front, to
/// `progress`.
pub fn measure(options: &ParetoOptions, mut progress: impl FnMut(&str)) -> Result<()> {
    for name in &options.backends {
        ensure!(BACKENDS.contains(&name.as_str()), "{name:?} is no back end: {}", BACKENDS.join(", "));
    }
    std::fs::create_dir_all(&options.out).with_context(|| format!("creating {}", options.out.display()))?;
    let mut rows = Vec::new();
    for name in &options.only {
        let (scene, path) = load(options, name)?;
        measure::check(&path)?;
        let automatic = tracer::automatic(&scene);
        let mut bench = Bench::new(name, &scene, &path, options.size, (options.samples, options.seconds))?;
        for backend in &options.backends {
            progress(&format!("{name}: {backend}"));
            if !bench.resolutions(backend, backend == automatic)? {
                progress(&format!("NOT MEASURED: {backend} on {name}: no adapter here has what it needs"));
                continue;
            }
            // The offset of `cpu` is a constant of its vector code.
            if backend == "compute" {
                bench.offsets()?;
            }
            if backend == automatic {
                bench.codecs(backend)?;
                bench.lossy(backend)?;
                bench.dim_lights(backend)?;
                bench.lags(backend)?;
            }
        }
        let mut of_scene = bench.rows();
        mark_front(&mut of_scene);
        for row in of_scene.iter().filter(|row| row.is_default && !row.on_front) {
            progress(&format!("DEFAULT OFF THE FRONT: {name}, {}, {} {}", row.backend, row.knob, row.value));
        }
        rows.extend(of_scene);
        // After each scene, so that an interrupted measurement leaves results.
        write(options, "pareto.csv", &table(&rows).csv())?;
        write(options, &format!("pareto-{name}.svg"), &plot(name, &rows).svg()?)?;
    }
    Ok(())
}

fn load(options: &ParetoOptions, name: &str) -> Result<(Scene, CameraPath)> {
    let folder = options.scenes.join(name);
    // Sponza has one file with lights and one without.
    let files = [format!("{name}_lights.gltf"), format!("{name}.glb"), format!("{name}.gltf")];
    let file = files.iter().map(|file| folder.join(file)).find(|file| file.is_file());
    let file = file.with_context(|| format!("no {} in {}", files.join(", "), folder.display()))?;
    let json = folder.join("lights_camera.json");
    let scene = Scene::load(&file, &LoadOptions { default_light: false, ..LoadOptions::default() });
    let scene = match scene {
        Ok(scene) if !scene.lights.is_empty() => scene,
        _ => Scene::load(&file, &LoadOptions { lights_from: Some(json.clone()), ..LoadOptions::default() })
            .with_context(|| format!("loading {}", file.display()))?,
    };
    let mut spec = json.into_os_string();
    if name == "sponza" {
        spec.push("#A_atrium_dolly");
    }
    let spec = spec.to_str().with_context(|| format!("{} is no UTF-8", folder.display()))?;
    Ok((scene, spec.parse::<PathSpec>()?.load()?))
}

fn mark_front(rows: &mut [Row]) {
    for group in [Group::Tracing, Group::Prediction] {
        let mut members: Vec<&mut Row> = rows.iter_mut().filter(|row| row.group == group).collect();
        let trades: Vec<Trade> =
            members.iter().map(|row| Trade { ms: row.ms_p50, bytes: row.bytes, error: row.bit_error }).collect();
        for (row, on_front) in members.iter_mut().zip(on_front(&trades)) {
            row.on_front = on_front;
        }
    }
}

fn table(rows: &[Row]) -> Table {
    let mut table = Table::new(
        "scene | backend | knob | value | ms_p50 | ms_p99 | rays | node_visits | bytes | bit_error | psnr \
         | flip | on_front | is_default",
    );
    table.rows.extend(rows.iter().map(|row| {
        let Row { ms_p50, ms_p99, rays, bytes, bit_error, psnr_db, flip, on_front, is_default, .. } = row;
        vec![
            row.scene.clone(),
            row.backend.clone(),
            row.knob.clone(),
            row.value.clone(),
            format!("{ms_p50:.3}"),
            format!("{ms_p99:.3}"),
            format!("{rays:.0}"),
            row.node_visits.map(|nodes| nodes.to_string()).unwrap_or_default(),
            format!("{bytes:.0}"),
            format!("{bit_error:.5}"),
            format!("{psnr_db:.2}"),
            format!("{flip:.5}"),
            on_front.to_string(),
            is_default.to_string(),
        ]
    }));
    table
}

/// Plots time against wrong bits of one scene: a series for each back end, and one for the default.
fn plot(scene: &str, rows: &[Row]) -> Plot {
    let rows: Vec<&Row> = rows.iter().filter(|row| row.scene == scene && row.group == Group::Tracing).collect();
    let points = |wanted: &dyn Fn(&Row) -> bool| {
        rows.iter().filter(|row| wanted(row)).map(|row| (row.ms_p50, row.bit_error)).collect::<Vec<_>>()
    };
    let mut series: Vec<Series> = BACKENDS
        .iter()
        .map(|&backend| Series::dots(backend, points(&|row| row.backend == backend && !row.is_default)))
        .filter(|series| !series.points.is_empty())
        .collect();
    let default = points(&|row| row.is_default);
    if !default.is_empty() {
        series.push(Series::dots("default", default));
    }
    let title = format!("{scene}: what less time costs");
    Plot::new(&title, Axis::log("tracing and encoding, ms (median)"), Axis::linear("wrong relevant bits, %"), series)
        .with_front(Front { x: Better::Low, y: Better::Low })
}

fn write(options: &ParetoOptions, name: &str, text: &str) -> Result<()> {
    let file = options.out.join(name);
    std::fs::write(&file, text).with_context(|| format!("writing {}", file.display()))
}
