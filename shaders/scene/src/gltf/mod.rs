//! Reads glTF 2.0, `.gltf` and `.glb`, into a [`Scene`] without trusting a byte of it.
//!
//! The way of a file: `container` splits it, `json` and `document` parse its JSON into bounded lists, `features` refuses what is
//! not read, `references` and `layout` check every index and offset, `nodes` checks and walks the tree, `buffers` loads
//! bytes, `flatten` makes triangles of `primitive`s and `material`s, `image` decodes pictures, `light` reads lights.

mod accessor;
mod buffers;
mod container;
mod document;
mod features;
mod flatten;
mod image;
mod json;
mod layout;
mod light;
mod material;
mod nodes;
mod primitive;
mod references;
mod uri;

use std::path::Path;

use glam::DVec3;

pub(super) use container::{read_file, read_start};

use self::{buffers::Buffers, document::Document, material::Materials};
use super::{Aabb, LoadReport, Scene, error::SceneError, limits::MAX_FILE_BYTES};

/// Reads a scene, with the lights that it has: perhaps none, perhaps too many.
///
/// # Errors
/// See [`SceneError`].
pub(super) fn load(path: &Path) -> Result<(Scene, LoadReport), SceneError> {
    let bytes = read_file(path, MAX_FILE_BYTES)?;
    let not_gltf = |fault: String| SceneError::NotGltf { path: path.to_owned(), fault };
    let container = container::split(&bytes).map_err(not_gltf)?;
    let document = document::parse(container.json).map_err(not_gltf)?;
    features::check(&document)?;
    references::check(&document)?;
    layout::check(&document)?;
    material::check(&document)?;
    let placed = nodes::walk(&document)?;

    let folder = path.parent().unwrap_or_else(|| Path::new(""));
    let buffers = Buffers::load(&document, container.bin, folder)?;
    read(&document, &buffers, &placed, folder)
}

fn read(
    document: &Document<'_>,
    buffers: &Buffers<'_>,
    placed: &[nodes::Placed],
    folder: &Path,
) -> Result<(Scene, LoadReport), SceneError> {
    let mut scene = Scene {
        origin_m: DVec3::ZERO,
        bounds: Aabb { min: glam::Vec3::ZERO, max: glam::Vec3::ZERO },
        positions: Vec::new(),
        normals: Vec::new(),
        uvs: Vec::new(),
        triangles: Vec::new(),
        draws: Vec::new(),
        materials: Vec::new(),
        images: Vec::new(),
        lights: Vec::new(),
        instances: 0,
    };
    let mut report = LoadReport::default();
    let mut materials = Materials::default();
    flatten::flatten(document, buffers, placed, &mut materials, &mut scene, &mut report)?;
    scene.lights = light::read(document, placed, scene.origin_m)?;
    scene.images = image::load(document, buffers, folder, &materials.images)?;
    scene.materials = materials.materials;
    if scene.triangles.is_empty() {
        return Err(SceneError::NoTriangles { dropped: report.dropped_triangles, skipped: report.skipped_primitives });
    }
    scene.bounds = Aabb::of(&scene);
    Ok((scene, report))
}
