//! What every report is made of: a scene, its lights, a camera path, a size, and a folder for what comes out.

use std::{ffi::OsString, fs, path::PathBuf};

use anyhow::{Context, Result};
use gnomon_client::camera_path::{CameraPath, PathSpec};
use gnomon_scene::{LoadOptions, Scene};

/// The options that all measuring subcommands share.
#[derive(Debug, Clone, clap::Args)]
pub struct SceneArgs {
    /// The scene, `.gltf` or `.glb`.
    #[arg(long)]
    pub scene: PathBuf,
    /// JSON file with lights, for a scene that has none.
    #[arg(long)]
    pub lights_from: Option<PathBuf>,
    /// Keeps the first lights only.
    #[arg(long)]
    pub lights: Option<u32>,
    /// Camera path, FILE or FILE#NAME; without it, the only one in lights_camera.json beside the scene.
    #[arg(long)]
    pub path: Option<OsString>,
    /// Size of the picture, WIDTHxHEIGHT.
    #[arg(long, value_parser = size, default_value = "640x360")]
    pub size: (u32, u32),
    /// Frames along the path.
    #[arg(long, default_value_t = 200, value_parser = clap::value_parser!(u32).range(1..))]
    pub frames: u32,
    /// Folder for tables and pictures.
    #[arg(long, default_value = "target/lab")]
    pub out: PathBuf,
}

impl SceneArgs {
    /// The scene with its lights.
    ///
    /// # Errors
    /// When it cannot be loaded.
    pub fn load_scene(&self) -> Result<Scene> {
        let options = LoadOptions { lights_from: self.lights_from.clone(), max_lights: self.lights };
        Scene::load(&self.scene, &options).with_context(|| format!("loading {}", self.scene.display()))
    }

    /// The lights' options as the server, and the client without one, take them.
    #[must_use]
    pub fn light_arguments(&self) -> Vec<OsString> {
        let mut arguments = Vec::new();
        if let Some(file) = &self.lights_from {
            arguments.extend(["--lights-from".into(), file.into()]);
        }
        if let Some(lights) = self.lights {
            arguments.extend(["--lights".into(), lights.to_string().into()]);
        }
        arguments
    }

    /// Where the camera path stands, as the client takes it: `FILE` or `FILE#NAME`.
    #[must_use]
    pub fn path_text(&self) -> OsString {
        self.path.clone().unwrap_or_else(|| self.scene.with_file_name("lights_camera.json").into())
    }

    /// The camera path.
    ///
    /// # Errors
    /// When it cannot be read.
    pub fn load_path(&self) -> Result<CameraPath> {
        let text = self.path_text();
        let text = text.to_str().with_context(|| format!("{} is no UTF-8", text.display()))?;
        let spec: PathSpec = text.parse()?;
        Ok(CameraPath::load(&spec)?)
    }

    /// The name of the scene in tables: its file's, without the ending.
    #[must_use]
    pub fn scene_name(&self) -> String {
        self.scene.file_stem().unwrap_or_default().to_string_lossy().into_owned()
    }

    /// The place of a result: in the folder for results, which is made when it is not there.
    ///
    /// # Errors
    /// When the folder cannot be made.
    pub fn result(&self, name: &str) -> Result<PathBuf> {
        fs::create_dir_all(&self.out).with_context(|| format!("creating {}", self.out.display()))?;
        Ok(self.out.join(name))
    }

    /// Writes `text` as the result `name`, and says where that is.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn write(&self, name: &str, text: &str) -> Result<PathBuf> {
        let file = self.result(name)?;
        fs::write(&file, text).with_context(|| format!("writing {}", file.display()))?;
        Ok(file)
    }
}

/// A size from `WIDTHxHEIGHT`.
///
/// # Errors
/// When the text is no such thing.
pub fn size(text: &str) -> Result<(u32, u32), String> {
    let parsed = text.split_once('x').and_then(|(width, height)| Some((width.parse().ok()?, height.parse().ok()?)));
    parsed.ok_or_else(|| format!("{text:?} is no size: write it as 640x360"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_two_numbers_with_an_x() {
        assert_eq!(size("640x360"), Ok((640, 360)));
        for bad in ["", "640", "640x", "x360", "640x360x2", "a×b"] {
            assert!(size(bad).unwrap_err().contains("640x360"), "{bad}");
        }
    }
}
