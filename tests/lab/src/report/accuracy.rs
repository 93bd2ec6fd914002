//! `lab accuracy`: errors of the back ends, on real scenes against the referee and on hard cases against their bounds.

use std::{
    fs,
    path::{Path, PathBuf},
};

use anyhow::{Context, Result};
use gnomon_protocol::mask::{Mask, MaskShape};
use gnomon_scene::{LoadOptions, Scene, camera::Camera};

use super::{scene_args, table::Table, trace_error::picture};
use crate::{
    backends::BackendName,
    hard_cases::{self, Case},
    metrics::RelevantError,
    reference::{Reference, Truth},
    scenes::real::{JUDGED, RealScene},
};

#[derive(Debug, Clone, clap::Args)]
pub struct AccuracyOptions {
    /// Folder of the real scenes.
    #[arg(long, env = crate::scenes::real::SCENES_VARIABLE)]
    pub scenes: Option<PathBuf>,
    /// Real scenes to judge, by name [default: all].
    #[arg(long, value_delimiter = ',')]
    pub only: Vec<String>,
    /// Size of the pictures of real scenes, WIDTHxHEIGHT.
    #[arg(long, value_parser = scene_args::size, default_value = "640x360")]
    pub size: (u32, u32),
    /// Hard cases to judge, by part of their names [default: all].
    #[arg(long, value_delimiter = ',')]
    pub cases: Vec<String>,
    /// Size of the pictures of hard cases, WIDTHxHEIGHT.
    #[arg(long, value_parser = scene_args::size, default_value = "320x180")]
    pub case_size: (u32, u32),
    /// What to judge.
    #[arg(long, value_enum, value_delimiter = ',', default_values_t = [Part::Scenes, Part::Cases])]
    pub parts: Vec<Part>,
    /// Back ends to judge; those without an adapter here are reported and left out.
    #[arg(long, value_enum, value_delimiter = ',', default_values_t = BackendName::ALL)]
    pub backends: Vec<BackendName>,
    /// Folder for tables and pictures.
    #[arg(long, default_value = "target/lab")]
    pub out: PathBuf,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Part {
    /// The real scenes: `accuracy.csv`.
    Scenes,
    /// The hard cases: `hard_cases.csv`.
    Cases,
}

#[derive(Debug)]
pub struct Judgement {
    /// One row per scene and back end, summed over its cameras.
    pub scenes: Table,
    /// One row per case, back end and measure.
    pub cases: Table,
}

/// Judges, writes tables and pictures, and reports each result to `progress`.
pub fn measure(options: &AccuracyOptions, mut progress: impl FnMut(&str)) -> Result<Judgement> {
    fs::create_dir_all(&options.out).with_context(|| format!("creating {}", options.out.display()))?;
    let probe = hard_cases::all((8, 8), false)?;
    let mut backends = options.backends.clone();
    for &backend in &options.backends {
        if !probe.first().map_or(Ok(true), |case| backend.is_here(&case.scene))? {
            progress(&format!("{}: no adapter here can run it", backend.name()));
            backends.retain(|&other| other != backend);
        }
    }
    let judges = |part| options.parts.contains(&part);
    let scenes = judge_scenes(options, &backends, judges(Part::Scenes), &mut progress)?;
    let cases = if judges(Part::Cases) { hard_cases::all(options.case_size, true)? } else { Vec::new() };
    let cases = judge_cases(options, &backends, cases, &mut progress)?;
    Ok(Judgement { scenes, cases })
}

fn judge_cases(
    options: &AccuracyOptions,
    backends: &[BackendName],
    mut cases: Vec<Case>,
    mut progress: impl FnMut(&str),
) -> Result<Table> {
    cases.retain(|case| options.cases.is_empty() || options.cases.iter().any(|part| case.name.contains(part)));
    let mut table = hard_cases::run(&cases, backends, |case, backend, mask, truth| {
        let error = truth.map(|truth| RelevantError::of(mask, truth));
        let error = error.map(|error| format!(": {error} {:?}", error.examples)).unwrap_or_default();
        progress(&format!("{} on {}{error}", case.name, backend.name()));
        let file = options.out.join(format!("case-{}-{}.png", case.name, backend.name()));
        let picture = truth.map_or_else(|| lit_picture(mask), |truth| picture(mask, truth));
        picture.save(&file).with_context(|| format!("writing {}", file.display()))
    })?;
    if !cases.is_empty() {
        table.rows.extend(hard_cases::left_out()?);
        write(&options.out, "hard_cases.csv", &table)?;
    }
    Ok(table)
}

/// Draws a mask without a truth: the more lights reach a pixel, the brighter it is.
fn lit_picture(mask: &Mask) -> image::RgbImage {
    let shape = mask.shape();
    image::RgbImage::from_fn(shape.width(), shape.height(), |x, y| {
        let lit = (0..shape.lights()).filter(|&light| mask.get(light, x, y)).count();
        let grey = lit * 200 / (shape.lights().max(1) as usize);
        image::Rgb([u8::try_from(grey).unwrap_or(u8::MAX); 3])
    })
}

fn judge_scenes(
    options: &AccuracyOptions,
    backends: &[BackendName],
    wanted: bool,
    mut progress: impl FnMut(&str),
) -> Result<Table> {
    let mut table =
        Table::new("scene | backend | size | lights | relevant_bits | wrong_bits | undecided_bits | worst_distance_px");
    let (width, height) = options.size;
    if !wanted {
        return Ok(table);
    }
    let folder = options.scenes.as_deref().context("--scenes names the folder of the real scenes")?;
    for real in JUDGED.iter().filter(|real| options.only.is_empty() || options.only.iter().any(|n| n == real.name)) {
        let judged = Judged::new(real, folder, options.size)?;
        for &backend in backends {
            let mut sum = RelevantError::default();
            for (place, (mask, truth)) in judged.masks(backend)?.iter().zip(&judged.truths).enumerate() {
                let error = RelevantError::of(mask, truth);
                progress(&format!("{} at stop {place}, {}: {error} {:?}", real.name, backend.name(), error.examples));
                let file = options.out.join(format!("{}-{place}-{}.png", real.name, backend.name()));
                picture(mask, truth).save(&file).with_context(|| format!("writing {}", file.display()))?;
                sum += error;
            }
            table.rows.push(vec![
                real.name.into(),
                backend.name().into(),
                format!("{width}x{height}"),
                judged.scene.lights.len().to_string(),
                sum.relevant.to_string(),
                sum.surely_wrong().to_string(),
                sum.undecided.to_string(),
                format!("{:.1}", sum.worst_distance_px),
            ]);
        }
    }
    write(&options.out, "accuracy.csv", &table)?;
    Ok(table)
}

fn write(folder: &Path, name: &str, table: &Table) -> Result<()> {
    let file = folder.join(name);
    fs::write(&file, table.csv()).with_context(|| format!("writing {}", file.display()))
}

/// A real scene and the referee's verdicts on it.
#[derive(Debug)]
pub struct Judged {
    pub scene: Scene,
    pub cameras: Vec<Camera>,
    pub truths: Vec<Truth>,
}

impl Judged {
    /// Loads a scene from the folder of scenes and has the referee judge it.
    pub fn new(real: &RealScene, folder: &Path, (width, height): (u32, u32)) -> Result<Self> {
        let lights_from = real.lights_from_json.then(|| real.json_in(folder));
        let options = LoadOptions { lights_from, ..LoadOptions::default() };
        let file = folder.join(real.file);
        let scene = Scene::load(&file, &options).with_context(|| format!("loading {}", file.display()))?;
        let cameras: Vec<_> = real.stops_in(folder)?.iter().map(|stop| stop.camera(width, height)).collect();
        let reference = Reference::new(&scene);
        let truths = cameras.iter().map(|camera| reference.trace(camera)).collect();
        Ok(Self { scene, cameras, truths })
    }

    pub fn masks(&self, backend: BackendName) -> Result<Vec<Mask>> {
        let mut trace = backend.open(&self.scene)?;
        let lights = u32::try_from(self.scene.lights.len())?;
        self.cameras
            .iter()
            .map(|camera| {
                let mut mask = Mask::new(MaskShape::new(camera.width, camera.height, lights)?);
                trace(camera, &mut mask)?;
                Ok(mask)
            })
            .collect()
    }
}
