//! Loading a scene from files: glTF or a packed scene, and a lights file where its own lights are not wanted.

use std::{
    fmt,
    path::{Path, PathBuf},
};

use super::{
    Scene,
    error::SceneError,
    gltf, lights_file,
    limits::{MAX_LIGHTS, MAX_PACKED_BYTES},
    pack,
};

/// What to load besides the scene file.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct LoadOptions {
    /// A lights file whose lights *replace* those of the scene.
    pub lights_from: Option<PathBuf>,
    /// Keep only the first so many lights: 1 to 32, and not more than there are.
    pub max_lights: Option<u32>,
}

/// What the loader left out or mended; all zeros for most files.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct LoadReport {
    /// Triangles without an area, dropped.
    pub dropped_triangles: u64,
    /// Normals of length zero, replaced by their faces' mean.
    pub repaired_normals: u64,
    /// Instances of point and line primitives, and of primitives without positions, skipped.
    pub skipped_primitives: u64,
    /// Morph targets, ignored: their weights are 0 at rest.
    pub ignored_morph_targets: u64,
}

impl fmt::Display for LoadReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { dropped_triangles, repaired_normals, skipped_primitives, ignored_morph_targets } = self;
        write!(
            f,
            "zero-area triangles dropped {dropped_triangles}, zero normals replaced {repaired_normals}, point and line \
             primitives skipped {skipped_primitives}, morph targets ignored {ignored_morph_targets}"
        )
    }
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
        let (mut scene, report) = if gltf::read_start(path, pack::MAGIC.len() as u64)? == pack::MAGIC {
            let fault = |fault| SceneError::Packed { path: path.to_owned(), fault };
            let packed = gltf::read_file(path, MAX_PACKED_BYTES)?;
            (Self::unpack(&packed).map_err(fault)?, LoadReport::default())
        } else {
            gltf::load(path)?
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
