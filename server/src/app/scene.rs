//! Loads the configured scene and packs it once for all clients.

use std::{path::Path, sync::Arc};

use bytes::Bytes;
use gnomon_protocol::{ids::SceneDigest, limits::MAX_SCENE_BYTES};
use gnomon_scene::{Animation, LoadOptions, LoadReport, Scene, WarningKind};

use super::error::StartError;
use crate::{admission::services::SceneAsset, config::ServerConfig, session::brightness};

pub(super) fn load_options(config: &ServerConfig) -> LoadOptions {
    LoadOptions {
        lights_from: config.lights_from.clone(),
        max_lights: config.lights,
        default_light: config.default_light.is_on(),
        scene: config.scene_name.clone(),
        animation: config.animation.clone(),
        variant: config.variant.clone(),
        editable: config.editable.iter().flat_map(|names| names.split(',')).map(str::to_owned).collect(),
    }
}

/// Loads a scene, and logs what is not as its file says.
/// Errors if it cannot be loaded, or is too large for clients.
pub(super) fn load(path: &Path, options: &LoadOptions) -> Result<(Arc<Scene>, SceneAsset), StartError> {
    let (scene, asset, report) = load_with_report(path, options)?;
    for warning in report.all() {
        match warning.kind {
            WarningKind::Mended | WarningKind::LeftOut => tracing::warn!(scene = %path.display(), "{warning}"),
            WarningKind::NotDrawn | WarningKind::Note => tracing::info!(scene = %path.display(), "{warning}"),
        }
    }
    Ok((scene, asset))
}

/// Errors as [`load`].
pub(super) fn load_with_report(
    path: &Path,
    options: &LoadOptions,
) -> Result<(Arc<Scene>, SceneAsset, LoadReport), StartError> {
    let (scene, report) = Scene::load_with_report(path, options)
        .map_err(|reason| StartError::Scene { path: path.to_owned(), reason: Box::new(reason) })?;
    let pack_error = |reason: String| StartError::Pack { path: path.to_owned(), reason };
    let packed = scene.pack().map_err(|error| pack_error(error.to_string()))?;
    if packed.len() as u64 > MAX_SCENE_BYTES {
        return Err(pack_error(format!("{} bytes; clients accept at most {MAX_SCENE_BYTES}", packed.len())));
    }
    let lights = u32::try_from(scene.lights.len()).map_err(|error| pack_error(error.to_string()))?;
    let digest = SceneDigest(*blake3::hash(&packed).as_bytes());
    let weights = brightness::weights(&scene);
    let moves = scene.animation.as_deref().is_some_and(Animation::moves_scene);
    let nodes = scene.animation.as_ref().map(|animation| animation.nodes.clone());
    let animation = nodes.map(|nodes| Box::new(Animation { nodes, ..Animation::default() }));
    let stage = Scene { lights: scene.lights.clone(), origin_m: scene.origin_m, animation, ..Scene::default() };
    Ok((Arc::new(scene), SceneAsset { packed: Bytes::from(packed), digest, lights, weights, moves, stage }, report))
}
