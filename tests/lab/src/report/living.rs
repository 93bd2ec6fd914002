//! `lab living`: errors of the `cpu` back end on scenes that move, at several times, against the referee's own
//! evaluation of the animation; and whether a moving scene's mask is that of the scene that stands still then.

use std::path::PathBuf;

use anyhow::{Context, Result};
use glam::DVec3;
use gnomon_protocol::mask::{Mask, MaskShape};
use gnomon_scene::{LoadOptions, Scene, camera::Camera};
use gnomon_server::visibility::backend::cpu::CpuBackend;

use super::{scene_args, table::Table};
use crate::{metrics::RelevantError, reference::Reference, scenes::living};

#[derive(Debug, Clone, clap::Args)]
pub struct LivingOptions {
    /// glTF files, shown with all their animations [default: small scenes built in code]
    pub files: Vec<PathBuf>,
    /// Times of the scene, in seconds.
    #[arg(long, value_delimiter = ',', default_values_t = living::TIMES_S)]
    pub times: Vec<f64>,
    /// Size of the pictures, WIDTHxHEIGHT.
    #[arg(long, value_parser = scene_args::size, default_value = "320x180")]
    pub size: (u32, u32),
}

/// What one picture shows.
#[derive(Debug)]
pub struct Judged {
    pub time_s: f64,
    pub mask: Mask,
    pub error: RelevantError,
    /// The mask is that of the scene that stands still at that time, bit by bit.
    pub as_still: bool,
}

/// Returns two views of a scene, from the front and from behind.
pub fn views(scene: &Scene, (width, height): (u32, u32)) -> [Camera; 2] {
    let (min, max) = (scene.bounds.min.as_dvec3(), scene.bounds.max.as_dvec3());
    let (middle, size) = ((min + max) / 2.0 + scene.origin_m, (max - min).length());
    [DVec3::new(0.45, 0.35, 0.75), DVec3::new(-0.6, 0.3, -0.4)]
        .map(|way| Camera::looking_at(middle + way * size, middle, 0.9, width, height))
}

/// Traces a scene at these times, from each camera.
pub fn judge(scene: &Scene, cameras: &[Camera], times_s: &[f64]) -> Result<Vec<Judged>> {
    let backend = CpuBackend::new(scene, None)?;
    let lights = u32::try_from(scene.lights.len())?;
    let mut all = Vec::new();
    for &time_s in times_s {
        let (reference, posed) = (Reference::at(scene, time_s), backend.pose(time_s));
        let unmoved = CpuBackend::new(&scene.still_at(time_s), None)?;
        for camera in cameras {
            let shape = MaskShape::new(camera.width, camera.height, lights)?;
            let [mut mask, mut still] = [Mask::new(shape), Mask::new(shape)];
            backend.trace_rows(camera, &mut mask, 0..shape.tiles_y(), posed.as_ref());
            unmoved.trace(camera, &mut still);
            let error = RelevantError::of(&mask, &reference.trace(camera));
            all.push(Judged { time_s, as_still: mask == still, mask, error });
        }
    }
    Ok(all)
}

/// Returns one row per scene, summed over its times and views.
pub fn measure(options: &LivingOptions, mut progress: impl FnMut(&str)) -> Result<Table> {
    let mut table = Table::new("scene | pieces | relevant bits | wrong | wrong % | undecided % | as still");
    let mut row = |name: &str, scene: &Scene| -> Result<()> {
        let mut sum = RelevantError::default();
        let judged = judge(scene, &views(scene, options.size), &options.times)?;
        let as_still = judged.iter().all(|judged| judged.as_still);
        judged.into_iter().for_each(|judged| sum += judged.error);
        progress(&format!("{name}: {sum}"));
        let percent = |share: f64| format!("{:.4}", 100.0 * share);
        #[expect(clippy::cast_precision_loss, reason = "bits of a few pictures")]
        let undecided = sum.undecided as f64 / sum.relevant.max(1) as f64;
        table.rows.push(vec![
            name.to_owned(),
            scene.animation.as_ref().map_or(0, |animation| animation.pieces.len()).to_string(),
            sum.relevant.to_string(),
            (sum.wrong - sum.wrong_undecided).to_string(),
            percent(sum.sure_share()),
            percent(undecided),
            as_still.to_string(),
        ]);
        Ok(())
    };
    if options.files.is_empty() {
        living::all().iter().try_for_each(|(name, scene)| row(name, scene))?;
    }
    for file in &options.files {
        let load = LoadOptions { animation: Some("all".to_owned()), ..LoadOptions::default() };
        let scene = Scene::load(file, &load).with_context(|| file.display().to_string())?;
        row(&file.file_stem().unwrap_or_default().to_string_lossy(), &scene)?;
    }
    Ok(table)
}
