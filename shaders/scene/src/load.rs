//! Loading a scene from files: glTF or a packed scene, and a lights file where its own lights are not wanted.

use std::path::{Path, PathBuf};

use crate::{
    LoadReport, Scene,
    error::SceneError,
    file::{read_file, read_start},
    lights_file,
    limits::{MAX_LIGHTS, MAX_PACKED_BYTES},
    pack, reader,
};

/// What to load besides the scene file.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct LoadOptions {
    /// A lights file whose lights *replace* those of the scene.
    pub lights_from: Option<PathBuf>,
    /// Keep only the first so many lights: 1 to 32, and not more than there are.
    pub max_lights: Option<u32>,
}

impl Scene {
    /// Loads a `.gltf` or `.glb` file, or one that holds what [`Self::pack`] made.
    ///
    /// # Errors
    /// See [`SceneError`].
    pub fn load(path: &Path, options: &LoadOptions) -> Result<Self, SceneError> {
        Self::load_with_report(path, options).map(|(scene, _)| scene)
    }

    /// Loads the same files, and says what was left out.
    ///
    /// # Errors
    /// See [`SceneError`].
    pub fn load_with_report(path: &Path, options: &LoadOptions) -> Result<(Self, LoadReport), SceneError> {
        let (mut scene, report) = if read_start(path, pack::MAGIC.len() as u64)? == pack::MAGIC {
            let fault = |fault| SceneError::Packed { path: path.to_owned(), fault };
            let packed = read_file(path, MAX_PACKED_BYTES)?;
            (Self::unpack(&packed).map_err(fault)?, LoadReport::default())
        } else {
            reader::load(path)?
        };
        if let Some(file) = &options.lights_from {
            scene.lights = lights_file::read(file, scene.origin_m)?;
        }
        let there = scene.lights.len();
        if let Some(asked) = options.max_lights {
            let count = usize::try_from(asked).ok().filter(|count| (1..=there.min(MAX_LIGHTS)).contains(count));
            match count {
                Some(count) => scene.lights.truncate(count),
                None if there == 0 => return Err(SceneError::NoLights),
                None => return Err(SceneError::LightCount { asked, there }),
            }
        }
        match scene.lights.len() {
            0 => Err(SceneError::NoLights),
            1..=MAX_LIGHTS => Ok((scene, report)),
            count => Err(SceneError::TooManyLights(count)),
        }
    }
}
