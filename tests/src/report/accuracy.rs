//! How wrong the back ends are: on the real scenes against the referee, and on the hard cases against their bounds.

use std::{
    fs,
    path::{Path, PathBuf},
};

use anyhow::{Context, Result};
use gnomon_protocol::mask::{Mask, MaskShape};
use gnomon_shaders::{camera::Camera, scene::LoadOptions, scene::Scene};

use super::{scene_args, table::Table, trace_error::picture};
use crate::{
    backends::BackendName,
    metrics::RelevantError,
    reference::{Reference, Truth},
    scenes::real::{JUDGED, RealScene},
};

/// What to judge, and where to put the results.
#[derive(Debug, Clone, clap::Args)]
pub struct AccuracyOptions {
    /// Folder that holds the real scenes.
    #[arg(long, env = crate::scenes::real::SCENES_VARIABLE)]
    pub scenes: PathBuf,
    /// Real scenes to judge, by name; all of them without it.
    #[arg(long, value_delimiter = ',')]
    pub only: Vec<String>,
    /// Size of the pictures of real scenes, WIDTHxHEIGHT.
    #[arg(long, value_parser = scene_args::size, default_value = "640x360")]
    pub size: (u32, u32),
    /// Back ends to judge.
    #[arg(long, value_enum, value_delimiter = ',', default_values_t = BackendName::ALL)]
    pub backends: Vec<BackendName>,
    /// Folder for tables and pictures.
    #[arg(long, default_value = "target/lab")]
    pub out: PathBuf,
}

/// Judges, writes `accuracy.csv` and pictures, and tells `progress` each result as a line. The table has a row for
/// every scene and back end, summed over the places that the scene is seen from.
///
/// # Errors
/// When a scene cannot be loaded, a back end cannot be opened, or a result cannot be written.
pub fn measure(options: &AccuracyOptions, mut progress: impl FnMut(&str)) -> Result<Table> {
    fs::create_dir_all(&options.out).with_context(|| format!("creating {}", options.out.display()))?;
    let mut table = Table::new(&[
        "scene",
        "backend",
        "size",
        "lights",
        "relevant_bits",
        "wrong_bits",
        "undecided_bits",
        "worst_distance_px",
    ]);
    let (width, height) = options.size;
    for real in JUDGED.iter().filter(|real| options.only.is_empty() || options.only.iter().any(|n| n == real.name)) {
        let judged = Judged::new(real, &options.scenes, options.size)?;
        for &backend in &options.backends {
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
    /// The scene.
    pub scene: Scene,
    /// The places that it is seen from.
    pub cameras: Vec<Camera>,
    /// The verdicts from each of them.
    pub truths: Vec<Truth>,
}

impl Judged {
    /// Loads a scene out of the folder of scenes, and has the referee judge it.
    ///
    /// # Errors
    /// When the scene or its camera path cannot be read.
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

    /// A back end's masks from each of the places.
    ///
    /// # Errors
    /// When the back end refuses the scene, or fails.
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
