//! How far a back end's masks are from the referee's, traced directly, without a network in between.

use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use gnomon_protocol::mask::{Mask, MaskShape};
use gnomon_server::visibility::backend::{compute::ComputeBackend, cpu::CpuBackend};
use gnomon_shaders::{
    camera::Camera,
    scene::{LoadOptions, Scene},
};

use crate::{
    metrics::RelevantError,
    reference::{Reference, Truth},
    scenes::real::{Stop, stop},
};

/// What to compare.
#[derive(Debug, Clone)]
pub struct TraceErrorOptions {
    /// The scene.
    pub scene: PathBuf,
    /// Lights for a scene that has none.
    pub lights_from: Option<PathBuf>,
    /// Keeps the first lights only.
    pub lights: Option<u32>,
    /// JSON file with camera paths.
    pub path: PathBuf,
    /// Name of the path, where the file has several.
    pub path_name: Option<String>,
    /// Times on the path, in seconds.
    pub times_s: Vec<f64>,
    /// Width and height in pixels.
    pub size: (u32, u32),
    /// `cpu`, `compute` or both.
    pub backends: Vec<String>,
    /// Lets `compute` run on a software adapter.
    pub allow_software: bool,
    /// Folder for a picture of each comparison.
    pub pictures: Option<PathBuf>,
}

/// Compares, and tells `progress` each result as a line.
///
/// # Errors
/// When the scene or the path cannot be read, there is no such back end, or a picture cannot be written.
pub fn compare(options: &TraceErrorOptions, mut progress: impl FnMut(&str)) -> Result<()> {
    let load = LoadOptions { lights_from: options.lights_from.clone(), max_lights: options.lights };
    let scene = Scene::load(&options.scene, &load).with_context(|| format!("loading {}", options.scene.display()))?;
    let reference = Reference::new(&scene);
    let (width, height) = options.size;
    let cameras = options.times_s.iter().map(|&time_s| {
        let stop: Stop = stop(&options.path, options.path_name.as_deref(), time_s)?;
        Ok(stop.camera(width, height))
    });
    let cameras = cameras.collect::<Result<Vec<Camera>>>()?;
    let truths: Vec<_> = cameras.iter().map(|camera| reference.trace(camera)).collect();
    let lights = u32::try_from(scene.lights.len()).context("more lights than a mask has")?;
    let mut mask = Mask::new(MaskShape::new(width, height, lights)?);
    for name in &options.backends {
        let mut backend = open(name, &scene, options.allow_software)?;
        for ((camera, truth), time_s) in cameras.iter().zip(&truths).zip(&options.times_s) {
            backend(camera, &mut mask)?;
            let error = RelevantError::of(&mask, truth);
            progress(&format!("{name} at {time_s} s: {error}; light, x, y of wrong ones: {:?}", error.examples));
            if let Some(folder) = &options.pictures {
                std::fs::create_dir_all(folder).with_context(|| format!("creating {}", folder.display()))?;
                let path = folder.join(format!("{name}-{time_s}.png"));
                picture(&mask, truth).save(&path).with_context(|| format!("writing {}", path.display()))?;
            }
        }
    }
    Ok(())
}

type Trace = Box<dyn FnMut(&Camera, &mut Mask) -> Result<()>>;

fn open(name: &str, scene: &Scene, allow_software: bool) -> Result<Trace> {
    Ok(match name {
        "cpu" => {
            let backend = CpuBackend::new(scene, None)?;
            Box::new(move |camera, mask| {
                let _cost = backend.trace(camera, mask);
                Ok(())
            })
        }
        "compute" => {
            let mut backend = ComputeBackend::open(scene, None, allow_software)?;
            Box::new(move |camera, mask| {
                backend.trace(camera, mask)?;
                Ok(())
            })
        }
        _ => bail!("{name:?} is no back end: cpu or compute"),
    })
}

/// Grey where right, the brighter the more lights reach the pixel; red for leaks, blue for false shadows, orange and cyan
/// for the same in doubt.
fn picture(mask: &Mask, truth: &Truth) -> image::RgbImage {
    image::RgbImage::from_fn(truth.width, truth.height, |x, y| {
        let verdict = truth.at(x, y);
        let bits = |word: u32| word.count_ones().min(32).to_le_bytes()[0];
        let grey = bits(verdict.lit) * (200 / bits(verdict.relevant).max(1));
        let mut colour = [grey; 3];
        for light in (0..truth.lights).filter(|light| verdict.relevant >> light & 1 == 1) {
            let (set, right) = (mask.get(light, x, y), verdict.lit >> light & 1 == 1);
            let doubt = verdict.undecided >> light & 1 == 1;
            match (set, right) {
                (true, false) => colour = if doubt { [255, 160, 0] } else { [255, 0, 0] },
                (false, true) => colour = if doubt { [0, 200, 255] } else { [0, 0, 255] },
                _ => {}
            }
        }
        image::Rgb(colour)
    })
}
