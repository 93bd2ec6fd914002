//! Loads a scene from files: glTF or a packed scene, and perhaps a lights file.

use std::path::Path;

use crate::{
    LoadOptions, LoadReport, Scene,
    error::SceneError,
    file::{read_file, read_start},
    lights, lights_file,
    limits::MAX_PACKED_BYTES,
    pack, reader,
    scene::alpha_rules,
};

impl Scene {
    /// Loads a `.gltf` or `.glb` file, or a file with the bytes of [`Self::pack`].
    ///
    /// # Errors
    /// See [`SceneError`].
    pub fn load(path: &Path, options: &LoadOptions) -> Result<Self, SceneError> {
        Self::load_with_report(path, options).map(|(scene, _)| scene)
    }

    /// Loads a scene as [`Self::load`], and reports what was left out or mended, and what is not drawn.
    ///
    /// # Errors
    /// See [`SceneError`].
    pub fn load_with_report(path: &Path, options: &LoadOptions) -> Result<(Self, LoadReport), SceneError> {
        let (mut scene, mut report) = if read_start(path, pack::MAGIC.len() as u64)? == pack::MAGIC {
            let fault = |fault| SceneError::Packed { path: path.to_owned(), fault };
            let packed = read_file(path, MAX_PACKED_BYTES)?;
            (Self::unpack(&packed).map_err(fault)?, LoadReport::default())
        } else {
            let (mut scene, mut report) = reader::load(path, options)?;
            report.alpha = alpha_rules::apply(&mut scene);
            (scene, report)
        };
        if let Some(file) = &options.lights_from {
            scene.lights = lights_file::read(file, scene.origin_m)?;
            scene.animation.iter_mut().for_each(|animation| animation.lights.clear());
            lights::drop_if_empty(&mut scene);
        }
        lights::choose(&mut scene, options, &mut report)?;
        Ok((scene, report))
    }
}
