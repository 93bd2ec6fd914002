//! `lab trace-error`: compares back ends' masks with the referee's, without a network.

use anyhow::{Context, Result};
use gnomon_protocol::mask::{Mask, MaskShape};
use gnomon_scene::camera::Camera;

use super::scene_args::SceneArgs;
use crate::{
    backends::BackendName,
    metrics::RelevantError,
    reference::{Reference, Truth},
};

#[derive(Debug, Clone, clap::Args)]
pub struct TraceErrorOptions {
    /// Scene, path and size.
    #[command(flatten)]
    pub scene: SceneArgs,
    /// Times on the path, in seconds.
    #[arg(long, value_delimiter = ',', default_value = "0")]
    pub times: Vec<f64>,
    /// Back ends to compare; software adapters count.
    #[arg(long, value_enum, value_delimiter = ',', default_values_t = BackendName::EVERYWHERE)]
    pub backends: Vec<BackendName>,
    /// Write a picture of each comparison.
    #[arg(long)]
    pub pictures: bool,
}

pub fn compare(options: &TraceErrorOptions, mut progress: impl FnMut(&str)) -> Result<()> {
    let scene = options.scene.load_scene()?;
    let path = options.scene.load_path()?;
    let reference = Reference::new(&scene);
    let (width, height) = options.scene.size;
    let cameras: Vec<Camera> = options.times.iter().map(|&time_s| path.camera(time_s, width, height)).collect();
    let truths: Vec<_> = cameras.iter().map(|camera| reference.trace(camera)).collect();
    let lights = u32::try_from(scene.lights.len()).context("more lights than a mask has")?;
    let mut mask = Mask::new(MaskShape::new(width, height, lights)?);
    for backend in &options.backends {
        let name = backend.name();
        let mut trace = backend.open(&scene)?;
        for ((camera, truth), time_s) in cameras.iter().zip(&truths).zip(&options.times) {
            trace(camera, &mut mask)?;
            let error = RelevantError::of(&mask, truth);
            progress(&format!("{name} at {time_s} s: {error}; light, x, y of wrong ones: {:?}", error.examples));
            if options.pictures {
                let path = options.scene.result(&format!("{name}-{time_s}.png"))?;
                picture(&mask, truth).save(&path).with_context(|| format!("writing {}", path.display()))?;
            }
        }
    }
    Ok(())
}

/// Grey where right, brighter for more lights; red for leaks, blue for false shadows; orange and cyan where undecided.
pub(super) fn picture(mask: &Mask, truth: &Truth) -> image::RgbImage {
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
