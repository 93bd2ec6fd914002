//! `lab living`: errors of the back ends on scenes that move, at several times, against the referee's own evaluation of
//! the animation; and whether a moving scene's mask is that of the scene that stands still then.

use std::path::PathBuf;

use anyhow::{Context, Result};
use glam::{DMat4, DVec3};
use gnomon_protocol::mask::{Mask, MaskShape};
use gnomon_scene::{Aabb, AnimatedNode, Animation, LoadOptions, Piece, Scene, camera::Camera};
use gnomon_server::visibility::backend::cpu::CpuBackend;

use super::{scene_args, table::Table};
use crate::{
    backends::BackendName,
    metrics::RelevantError,
    reference::Reference,
    scenes::{builder::SceneBuilder, living},
};

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
    /// Which of them trace; `ray-query` needs an adapter that has it.
    #[arg(long, value_enum, value_delimiter = ',', default_values_t = BackendName::EVERYWHERE)]
    pub backends: Vec<BackendName>,
}

/// What one picture shows.
#[derive(Debug)]
pub struct Judged {
    pub backend: BackendName,
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

/// Traces a scene at these times, from each camera, with each back end: in this order, the back ends innermost.
pub fn judge(scene: &Scene, cameras: &[Camera], times_s: &[f64], backends: &[BackendName]) -> Result<Vec<Judged>> {
    let mut traces = backends.iter().map(|backend| backend.open_at(scene)).collect::<Result<Vec<_>>>()?;
    let lights = u32::try_from(scene.lights.len())?;
    let mut all = Vec::new();
    for &time_s in times_s {
        let (reference, unmoved) = (Reference::at(scene, time_s), scene.still_at(time_s));
        let mut stills = backends.iter().map(|backend| backend.open(&unmoved)).collect::<Result<Vec<_>>>()?;
        for camera in cameras {
            let truth = reference.trace(camera);
            for ((&backend, trace), unmoved) in backends.iter().zip(&mut traces).zip(&mut stills) {
                let shape = MaskShape::new(camera.width, camera.height, lights)?;
                let [mut mask, mut still] = [Mask::new(shape), Mask::new(shape)];
                trace(camera, time_s, &mut mask)?;
                unmoved(camera, &mut still)?;
                let error = RelevantError::of(&mask, &truth);
                all.push(Judged { backend, time_s, as_still: mask == still, mask, error });
            }
        }
    }
    Ok(all)
}

/// Returns the scene at a time, in pieces that are rigid: their hierarchies are built for what they are then.
fn built_anew(scene: &Scene, time_s: f64) -> Option<Scene> {
    let (mut anew, moment) = (scene.clone(), scene.moment(time_s)?);
    let pieces = anew.animation.take()?;
    let node =
        |visible| AnimatedNode { visible, above: DMat4::from_translation(scene.origin_m), ..SceneBuilder::node(None) };
    let mut animation = Animation { nodes: vec![node(false), node(true)], ..Animation::default() };
    for ((piece, own), placement) in pieces.pieces.iter().zip(pieces.own_vertices()).zip(&moment.pieces) {
        let first = animation.positions.len();
        for at in 0..own.positions.len() {
            let (position, normal) = placement.as_ref().map_or_else(Default::default, |it| it.vertex(&own, at));
            animation.positions.push(position);
            animation.normals.push(normal);
        }
        let bounds = Aabb::around(animation.positions.iter().skip(first));
        let mirrored = placement.as_ref().is_some_and(|placement| placement.turned);
        animation.pieces.push(Piece { node: placement.is_some().into(), bounds, mirrored, ..*piece });
    }
    (anew.animation, anew.lights) = (Some(Box::new(animation)), moment.lights);
    Some(anew)
}

/// Returns how many nodes rays visit on `cpu`, as a share of those that they visit if each piece's hierarchy is built
/// anew.
fn nodes_visited(scene: &Scene, cameras: &[Camera], times_s: &[f64]) -> Result<f64> {
    let refitted = CpuBackend::new(scene, None)?;
    let (mut visited, mut anew) = (0, 0);
    for &time_s in times_s {
        let Some(anew_then) = built_anew(scene, time_s) else { continue };
        let built = CpuBackend::new(&anew_then, None)?;
        for camera in cameras {
            let shape = MaskShape::new(camera.width, camera.height, u32::try_from(scene.lights.len())?)?;
            let nodes = |backend: &CpuBackend| {
                let (_, stats) = backend.trace_counted(camera, time_s, &mut Mask::new(shape));
                stats.iter().map(|stats| stats.nodes).sum::<u64>()
            };
            visited += nodes(&refitted);
            anew += nodes(&built);
        }
    }
    Ok(visited as f64 / anew.max(1) as f64)
}

/// Returns one row per scene and back end, summed over its times and views.
pub fn measure(options: &LivingOptions, mut progress: impl FnMut(&str)) -> Result<Table> {
    let mut table = Table::new(
        "scene | pieces | shapes | back end | relevant bits | wrong | wrong % | undecided | as still | nodes (anew: 1)",
    );
    let mut row = |name: &str, scene: &Scene| -> Result<()> {
        let cameras = views(scene, options.size);
        let judged = judge(scene, &cameras, &options.times, &options.backends)?;
        let nodes = nodes_visited(scene, &cameras, &options.times)?;
        for &backend in &options.backends {
            let mut sum = RelevantError::default();
            let of_backend = || judged.iter().filter(|judged| judged.backend == backend);
            let as_still = of_backend().all(|judged| judged.as_still);
            of_backend().for_each(|judged| sum += judged.error.clone());
            progress(&format!("{name} on {}: {sum}", backend.name()));
            table.rows.push(vec![
                name.to_owned(),
                scene.animation.as_ref().map_or(0, |animation| animation.pieces.len()).to_string(),
                scene.animation.as_ref().map_or(0, |animation| animation.shapes.len()).to_string(),
                backend.name().to_owned(),
                sum.relevant.to_string(),
                (sum.wrong - sum.wrong_undecided).to_string(),
                format!("{:.4}", 100.0 * sum.sure_share()),
                sum.undecided.to_string(),
                as_still.to_string(),
                format!("{nodes:.2}"),
            ]);
        }
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
