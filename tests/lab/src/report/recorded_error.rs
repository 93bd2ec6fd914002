//! Error of a recorded run: masks are applied as the client received them, in parts too; pictures are redrawn and
//! judged by the referee.

use std::path::Path;

use anyhow::{Context, Result, ensure};
use gnomon_client::record::replay::{Records, Replayed, replay};
use gnomon_scene::Scene;
use gnomon_shaders::gpu::{Gpu, GpuOptions};

use super::{prediction_error::PredictionError, replay::recorded_scene, scene_args::SceneArgs};
use crate::reference::Reference;

pub(super) struct Judge {
    gpu: Gpu,
    loaded: Scene,
    reference: Reference,
}

impl Judge {
    pub(super) fn new(scene: &SceneArgs, allow_software: bool) -> Result<Self> {
        let gpu = pollster::block_on(Gpu::open(&GpuOptions { allow_software, ..GpuOptions::default() }))?;
        let loaded = scene.load_scene()?;
        Ok(Self { gpu, reference: Reference::new(&loaded), loaded })
    }

    /// Returns the error over `samples` of `frames` pictures, from `first` on. A picture in mid-fade counts as the mask
    /// or the client's own visibility, whichever it shows more of.
    pub(super) fn error_of(
        &self,
        recording: &Path,
        (first, frames): (u32, u32),
        samples: u32,
    ) -> Result<PredictionError> {
        let (start, mut records) =
            Records::open(recording).with_context(|| format!("opening {}", recording.display()))?;
        let scene = recorded_scene(self.loaded.clone(), &start)?;
        let pictures = frames.saturating_sub(first);
        let samples = samples.min(pictures);
        let places: Vec<u32> = (0..samples).map(|sample| first + (2 * sample + 1) * pictures / (2 * samples)).collect();
        let (mut error, mut judged) = (PredictionError::default(), 0);
        let wanted = |frame: u32| places.contains(&frame);
        replay::<anyhow::Error>(&self.gpu, &scene, &start, &mut records, wanted, |replayed| {
            if let Replayed::Picture { shown, scene: at, visibility_share, renderer, .. } = replayed {
                let mut visibility = renderer.read_visibility()?;
                if visibility_share < 0.5 {
                    visibility.iter_mut().for_each(|pixel| (pixel.word, pixel.known) = (pixel.own, false));
                }
                judged += 1;
                let truth = match self.loaded.animation {
                    // The referee evaluates animations itself, and takes edits as the scene has them.
                    _ if !at.edits.is_empty() => Reference::new(&self.loaded.still_at(&at)).trace(&shown),
                    Some(_) => Reference::at(&self.loaded, at.time_s).trace(&shown),
                    None => self.reference.trace(&shown),
                };
                error.add(&visibility, &truth, None);
            }
            Ok(())
        })?;
        ensure!(judged == samples && error.relevant > 0, "{judged} of {samples} pictures are in the recording");
        Ok(error)
    }
}
