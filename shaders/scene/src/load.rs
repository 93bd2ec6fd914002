//! Loads a scene from files: glTF or a packed scene, and perhaps a lights file.

use std::path::{Path, PathBuf};

use crate::{
    LoadReport, Scene,
    error::SceneError,
    file::{read_file, read_start},
    lights_file,
    limits::{MAX_LIGHTS, MAX_PACKED_BYTES},
    pack, reader,
    scene::alpha_rules,
};

/// Options of [`Scene::load`].
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct LoadOptions {
    /// A lights file whose lights *replace* those of the scene.
    pub lights_from: Option<PathBuf>,
    /// Keeps only the first N lights: 1 to 32, and not more than the scene has.
    pub max_lights: Option<u32>,
}

impl Scene {
    /// Loads a `.gltf` or `.glb` file, or a file with the bytes of [`Self::pack`].
    ///
    /// # Errors
    /// See [`SceneError`].
    pub fn load(path: &Path, options: &LoadOptions) -> Result<Self, SceneError> {
        Self::load_with_report(path, options).map(|(scene, _)| scene)
    }

    /// Loads a scene as [`Self::load`], and reports what was left out.
    ///
    /// # Errors
    /// See [`SceneError`].
    pub fn load_with_report(path: &Path, options: &LoadOptions) -> Result<(Self, LoadReport), SceneError> {
        let (mut scene, report) = if read_start(path, pack::MAGIC.len() as u64)? == pack::MAGIC {
            let fault = |fault| SceneError::Packed { path: path.to_owned(), fault };
            let packed = read_file(path, MAX_PACKED_BYTES)?;
            (Self::unpack(&packed).map_err(fault)?, LoadReport::default())
        } else {
            let (mut scene, mut report) = reader::load(path)?;
            report.alpha = alpha_rules::apply(&mut scene);
            (scene, report)
        };
        if let Some(file) = &options.lights_from {
            scene.lights = lights_file::read(file, scene.origin_m)?;
        }
        let available = scene.lights.len();
        if let Some(requested) = options.max_lights {
            let count = usize::try_from(requested).ok().filter(|count| (1..=available.min(MAX_LIGHTS)).contains(count));
            match count {
                Some(count) => scene.lights.truncate(count),
                None if available == 0 => return Err(SceneError::NoLights),
                None => return Err(SceneError::LightCount { requested, available }),
            }
        }
        match scene.lights.len() {
            0 => Err(SceneError::NoLights),
            1..=MAX_LIGHTS => Ok((scene, report)),
            count => Err(SceneError::TooManyLights(count)),
        }
    }
}
