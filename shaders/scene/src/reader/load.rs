//! Turns a file into a scene.

use std::path::Path;

use super::{
    checks::{features, layout, references},
    compression,
    file::{buffers::Buffers, glb},
    flatten::{
        image, light,
        material::{self, Materials},
        meshes, nodes,
    },
    json::{self, Document},
    report::LoadReport,
};
use crate::{Aabb, Scene, error::SceneError, file::read_file, limits::MAX_FILE_BYTES};

/// Reads a scene. It may have no lights, or too many.
pub(crate) fn load(path: &Path) -> Result<(Scene, LoadReport), SceneError> {
    let bytes = read_file(path, MAX_FILE_BYTES)?;
    let not_gltf = |fault: String| SceneError::NotGltf { path: path.to_owned(), fault };
    let container = glb::split(&bytes).map_err(not_gltf)?;
    let mut document = json::parse(container.json).map_err(not_gltf)?;
    features::check(&document)?;
    references::check(&document)?;
    layout::check(&document.json)?;
    material::check(&document)?;
    let placed = nodes::walk(&document)?;

    let folder = path.parent().unwrap_or_else(|| Path::new(""));
    let mut buffers = Buffers::load(&document.json, container.bin, folder)?;
    compression::expand(&mut document, &mut buffers)?;
    read(&document, &buffers, &placed, folder)
}

fn read(
    document: &Document,
    buffers: &Buffers<'_>,
    placed: &[nodes::Placed],
    folder: &Path,
) -> Result<(Scene, LoadReport), SceneError> {
    let mut scene = Scene::default();
    let mut report = LoadReport::default();
    let mut materials = Materials::default();
    meshes::flatten(document, buffers, placed, &mut materials, &mut scene, &mut report)?;
    scene.lights = light::read(document, placed, scene.origin_m)?;
    scene.images = image::load(&document.json, buffers, folder, &materials.images, &mut report)?;
    scene.materials = materials.materials;
    if scene.triangles.is_empty() {
        return Err(SceneError::NoTriangles { dropped: report.dropped_triangles, skipped: report.skipped_primitives });
    }
    scene.bounds = Aabb::of(&scene);
    Ok((scene, report))
}
