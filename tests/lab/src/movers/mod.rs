//! Real scenes in which things move, to measure with: walking figures, rolling balls, opening doors and swinging lamps
//! among what a file has, a fan of its leaves, and one of its lights that travels.
//!
//! [`write`] puts them into a copy of a `.gltf` file. Its animations `things`, `fan` and `light` move them; without
//! one, they stand in the same scene.

mod shapes;
mod things;

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use glam::{DQuat, DVec2, DVec3, Vec3};
use gnomon_scene::{LoadOptions, Scene, SceneError};
use serde_json::{Value, json};

use crate::cloister::glb::{Glb, at, mesh_node};
use things::{Kinds, key_times, moving, single, turning};

pub use things::TRIANGLES;

/// Name of the animation that moves what [`write`] counts.
pub const THINGS: &str = "things";

#[derive(Debug, thiserror::Error)]
pub enum MoversError {
    #[error("cannot load the scene: {0}")]
    Scene(#[from] SceneError),
    #[error("{} is no .gltf file: {source}", path.display())]
    Json { path: PathBuf, source: serde_json::Error },
    #[error("cannot copy or write {}: {source}", path.display())]
    File { path: PathBuf, source: io::Error },
}

/// Copies a `.gltf` file and what it refers to into a folder, with `count` things that move, a fan if it has MASK
/// leaves, and one of its point lights travelling. Returns the new file's path.
///
/// # Errors
/// If the scene cannot be read, or the folder not written.
pub fn write(source: &Path, count: u32, out: &Path) -> Result<PathBuf, MoversError> {
    let scene = Scene::load(source, &LoadOptions::default())?;
    let failed = |path: &Path| {
        let path = path.to_owned();
        move |source| MoversError::File { path, source }
    };
    let text = fs::read(source).map_err(failed(source))?;
    let mut document: Value =
        serde_json::from_slice(&text).map_err(|error| MoversError::Json { path: source.to_owned(), source: error })?;
    for uri in uris(&document) {
        let (from, to) = (source.with_file_name(&uri), out.join(&uri));
        fs::create_dir_all(to.parent().unwrap_or(out)).map_err(failed(&to))?;
        fs::copy(&from, &to).map_err(failed(&from))?;
    }
    let stem = source.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let binary = format!("{stem}_moving.bin");
    let bytes = add(&mut document, &scene, count, &binary);
    let file = out.join(format!("{stem}_moving.gltf"));
    for (path, bytes) in [(out.join(&binary), bytes), (file.clone(), document.to_string().into_bytes())] {
        fs::write(&path, bytes).map_err(failed(&path))?;
    }
    Ok(file)
}

/// The files that a document refers to, once each.
fn uris(document: &Value) -> Vec<String> {
    let lists = ["buffers", "images"].map(|list| document[list].as_array());
    let uris = lists.into_iter().flatten().flatten().filter_map(|part| part["uri"].as_str());
    let mut uris: Vec<String> = uris.filter(|uri| !uri.starts_with("data:")).map(str::to_owned).collect();
    uris.sort_unstable();
    uris.dedup();
    uris
}

/// Adds all that moves. Returns the bytes of the new buffer, `uri`.
fn add(document: &mut Value, scene: &Scene, count: u32, uri: &str) -> Vec<u8> {
    let (low, high) = (scene.bounds.min.as_dvec3(), scene.bounds.max.as_dvec3());
    let (middle, size) = ((low + high) * 0.5, high - low);
    // Not on roofs.
    let most = low.y + size.y * 0.1;
    // A figure is a seventh of the shortest side.
    let unit = size.min_element() / 12.0;
    let leaves = document["materials"].as_array().and_then(|all| all.iter().position(|it| it["alphaMode"] == "MASK"));
    let light = document["nodes"].as_array().and_then(|all| all.iter().position(|node| is_lamp(document, node)));
    let mut glb = Glb::within(document);
    let kinds = Kinds::new(&mut glb, unit);
    let mut channels = Vec::new();
    for number in 0..count {
        // Spread evenly, as seeds are on a sunflower.
        let reach = 0.55 * (f64::from(number + 1) / f64::from(count + 1)).sqrt();
        let way = DVec2::from_angle(f64::from(number) * 2.399_963) * reach;
        let at = middle + DVec3::new(way.x * size.x, 0.0, way.y * size.z) * 0.5;
        let floor = DVec3::new(at.x, floor_below(scene, at, most), at.z);
        channels.extend(kinds.add(&mut glb, number, floor + scene.origin_m));
    }
    if !channels.is_empty() {
        glb.animation(THINGS, &key_times(), &channels);
    }
    if let Some(leaves) = leaves {
        let aside = middle + DVec3::Z * 1.5 * unit;
        let hub = DVec3::new(aside.x, floor_below(scene, aside, most) + 2.5 * unit, aside.z);
        let radius = single(unit);
        let fan = glb.mesh("fan", &[(leaves, shapes::fan(8, 0.15 * radius, radius))]);
        let fan = glb.node(None, at(mesh_node("fan", fan), hub + scene.origin_m));
        let spin = turning(fan, |now| DQuat::from_rotation_x(now * 2.0 * std::f64::consts::TAU));
        glb.animation("fan", &key_times(), &[spin]);
    }
    if let Some(light) = light {
        let part = |axis: usize| document["nodes"][light]["translation"][axis].as_f64().unwrap_or_default();
        let rest = DVec3::from_array([0, 1, 2].map(part));
        let travel = moving(light, |now| rest + DVec3::X * 1.2 * unit * (now * std::f64::consts::TAU).sin());
        glb.animation("light", &key_times(), &[travel]);
    }
    glb.put_back(document, uri)
}

/// Whether a node has a point light, and no matrix that an animation could not move.
fn is_lamp(document: &Value, node: &Value) -> bool {
    let light = node["extensions"]["KHR_lights_punctual"]["light"].as_u64().and_then(|it| usize::try_from(it).ok());
    let lights = &document["extensions"]["KHR_lights_punctual"]["lights"];
    light.is_some_and(|light| lights[light]["type"] == json!("point")) && node["matrix"].is_null()
}

/// The greatest height of a surface below a point, not above `most`; the scene's lowest if there is none.
fn floor_below(scene: &Scene, at: DVec3, most: f64) -> f64 {
    let height = |corners: &[u32; 3]| {
        let [a, b, c] = corners.map(|corner| scene.positions.get(corner as usize).copied().unwrap_or(Vec3::ZERO));
        let [a, b, c] = [a, b, c].map(Vec3::as_dvec3);
        let flat = |v: DVec3| DVec2::new(v.x, v.z);
        let area = flat(b - a).perp_dot(flat(c - a));
        let [u, v] = [flat(at - a).perp_dot(flat(c - a)) / area, flat(b - a).perp_dot(flat(at - a)) / area];
        (u >= 0.0 && v >= 0.0 && u + v <= 1.0).then_some(a.y + (b.y - a.y) * u + (c.y - a.y) * v)
    };
    let below = scene.tracing_triangles().iter().filter_map(height).filter(|height| *height <= most);
    below.reduce(f64::max).unwrap_or_else(|| f64::from(scene.bounds.min.y))
}

#[cfg(test)]
mod tests {
    use gnomon_scene::testing::write_scene;

    use super::*;

    #[test]
    fn things_of_a_thousand_triangles_stand_on_the_floor_and_move() {
        let [from, to] = [(); 2].map(|()| tempfile::tempdir().unwrap());
        let source = write_scene(from.path()).unwrap();
        let still = Scene::load(&source, &LoadOptions::default()).unwrap();
        let load = |count: u32, animation: &str| {
            let file = write(&source, count, to.path()).unwrap();
            let options = LoadOptions { animation: Some(animation.to_owned()), ..LoadOptions::default() };
            Scene::load(&file, &options).unwrap()
        };
        let standing = load(6, "off");
        assert_eq!(standing.animation, None);
        assert_eq!(standing.triangles.len(), still.triangles.len() + 6 * TRIANGLES);
        let moving = load(6, THINGS);
        // Two of six are figures, of five pieces each.
        assert_eq!(moving.animation.as_ref().map(|animation| animation.pieces.len()), Some(4 + 2 * 5));
        let (one, other) = (moving.still_at(0.4), moving.still_at(1.3));
        assert_eq!(one.triangles.len(), standing.triangles.len());
        assert_ne!(one.positions, other.positions);
        assert!(one.positions.iter().all(|at| at.y > -0.01), "sunk into the floor");
        let travelling = load(6, "light");
        assert!(travelling.animation.as_ref().is_some_and(|animation| animation.pieces.is_empty()));
        assert_ne!(travelling.still_at(0.4).lights, travelling.still_at(1.3).lights);
        assert_eq!(load(0, "all").triangles.len(), still.triangles.len());
    }
}
