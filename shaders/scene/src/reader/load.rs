//! Turns a file into a scene.

use std::path::Path;

use super::{
    checks::{features, layout, references},
    compression,
    file::{buffers::Buffers, glb},
    flatten::{
        animation, camera,
        channels::{self, Channels},
        finish, image, light,
        materials::{self, Materials, listed},
        meshes::Meshes,
        nodes::{self, Walk},
    },
    json::{self, Document},
    report::{LoadReport, WarningKind},
};
use crate::{Aabb, Animation, LoadOptions, Scene, error::SceneError, file::read_file, limits::MAX_FILE_BYTES};

/// Reads a scene. It may have no lights, or too many.
pub(crate) fn load(path: &Path, options: &LoadOptions) -> Result<(Scene, LoadReport), SceneError> {
    let bytes = read_file(path, MAX_FILE_BYTES)?;
    let not_gltf = |fault: String| SceneError::NotGltf { path: path.to_owned(), fault };
    let container = glb::split(&bytes).map_err(not_gltf)?;
    let mut document = json::parse(container.json).map_err(not_gltf)?;
    let mut report = LoadReport::default();
    features::check(&document, &mut report)?;
    references::check(&document, &mut report)?;
    layout::check(&document.json, &mut report)?;
    let variant = variant(&document, options, &mut report)?;

    let folder = path.parent().unwrap_or_else(|| Path::new(""));
    let mut buffers = Buffers::load(&document.json, container.bin, folder)?;
    compression::expand(&mut document, &mut buffers)?;
    let mut materials = Materials::default();
    materials.variant = variant;
    let mut channels = channels::read(&document, &buffers, options.animation.as_deref(), &mut report)?;
    channels.allow_edits(&document, &options.editable)?;
    let walk = nodes::walk(&document, &channels, options.scene.as_deref(), &mut report)?;
    let (mut scene, animation) = read(&document, &buffers, (&walk, &channels), materials, folder, &mut report)?;
    animation::finish(&mut scene, animation, &channels, &mut report);
    Ok((scene, report))
}

/// Returns the wanted variant. Without a wish, tells which ones there are.
fn variant(document: &Document, options: &LoadOptions, report: &mut LoadReport) -> Result<Option<usize>, SceneError> {
    if let Some(wanted) = &options.variant {
        return materials::variant(document, wanted).map(Some);
    }
    let names: Vec<&str> = document.variants.iter().map(|variant| variant.name.as_deref().unwrap_or("")).collect();
    if !names.is_empty() {
        let what = format!("material variants, shown with --variant NAME: {}", listed(&names));
        report.add(WarningKind::Note, what, "", 1);
    }
    Ok(None)
}

fn read(
    document: &Document,
    buffers: &Buffers<'_>,
    (walk, channels): (&Walk, &Channels),
    mut materials: Materials,
    folder: &Path,
    report: &mut LoadReport,
) -> Result<(Scene, Animation), SceneError> {
    let (mut scene, nodes) = (Scene::default(), walk.animated.clone());
    let mut animation = Animation { nodes, ..Animation::default() };
    Meshes { document, buffers, walk, channels }.flatten(&mut materials, &mut scene, &mut animation, report)?;
    finish(&mut scene, &mut animation);
    (scene.lights, animation.lights) = light::read(document, channels, &walk.placed, scene.origin_m, report)?;
    (scene.cameras, animation.cameras) = camera::read(document, channels, &walk.placed, report);
    let pictures = image::load(&document.json, buffers, folder, &materials.images.0, report)?;
    scene.images = pictures.images;
    scene.materials = materials.finish(&pictures.indices);
    if scene.triangles.is_empty() {
        let (dropped, skipped) = (report.dropped_triangles, report.skipped_primitives);
        return Err(SceneError::NoTriangles { dropped, skipped, report: Box::new(std::mem::take(report)) });
    }
    scene.bounds = Aabb::of(&scene);
    // Pieces are added by the order of their materials; their vertices lie in the same order.
    Ok((scene, animation))
}
