//! Options shared by the reports: scene, lights, camera path, size, and folder for results.

use std::{
    ffi::OsString,
    fs,
    path::{Path, PathBuf},
};

use anyhow::{Context, Result};
use gnomon_client::camera_path::{CameraPath, PathSpec};
use gnomon_scene::{LoadOptions, Scene};

use crate::rig::ClientJob;

/// A scene and its lights.
#[derive(Debug, Clone, clap::Args)]
pub struct SceneFile {
    /// The scene, `.gltf` or `.glb`.
    #[arg(long)]
    pub scene: PathBuf,
    /// JSON file with lights, for a scene that has none.
    #[arg(long)]
    pub lights_from: Option<PathBuf>,
    /// Keeps only the first N lights.
    #[arg(long)]
    pub lights: Option<u32>,
    /// Name or number of the animation that moves the scene; `all` takes all together.
    #[arg(long)]
    pub animation: Option<String>,
}

#[derive(Debug, Clone, clap::Args)]
pub struct SceneArgs {
    #[command(flatten)]
    pub file: SceneFile,
    /// Camera path, FILE or FILE#NAME [default: the only one in lights_camera.json beside the scene].
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

impl SceneFile {
    pub fn load(&self) -> Result<Scene> {
        let options = LoadOptions {
            lights_from: self.lights_from.clone(),
            max_lights: self.lights,
            animation: self.animation.clone(),
            ..LoadOptions::default()
        };
        Scene::load(&self.scene, &options).with_context(|| format!("loading {}", self.scene.display()))
    }
}

impl SceneArgs {
    pub fn load_scene(&self) -> Result<Scene> {
        self.file.load()
    }

    /// Returns the lights' options for the server, or for a client without one.
    pub fn light_arguments(&self) -> Vec<OsString> {
        let mut arguments = Vec::new();
        if let Some(file) = &self.file.lights_from {
            arguments.extend(["--lights-from".into(), file.into()]);
        }
        if let Some(lights) = self.file.lights {
            arguments.extend(["--lights".into(), lights.to_string().into()]);
        }
        if let Some(animation) = &self.file.animation {
            arguments.extend(["--animation".into(), animation.into()]);
        }
        arguments
    }

    /// Returns the camera path as the client takes it: `FILE` or `FILE#NAME`.
    pub fn path_text(&self) -> OsString {
        self.path.clone().unwrap_or_else(|| self.file.scene.with_file_name("lights_camera.json").into())
    }

    pub fn client_job<'a>(
        &self,
        url: Option<&'a str>,
        folder: &'a Path,
        mut arguments: Vec<OsString>,
        allow_software: bool,
    ) -> ClientJob<'a> {
        arguments.extend(allow_software.then(|| "--allow-software".into()));
        let (path, frames, size) = (self.path_text(), self.frames, self.size);
        ClientJob { url, path, frames, size, folder, save_masks: false, arguments }
    }

    /// Returns a server's arguments for its transport and back end, and the scene's lights.
    pub fn server_arguments(&self, transport: &str, backend: &str, allow_software: bool) -> Vec<OsString> {
        let mut arguments = self.light_arguments();
        arguments.extend(["--transport", transport, "--backend", backend].map(Into::into));
        arguments.extend(allow_software.then(|| "--allow-software".into()));
        arguments
    }

    pub fn load_path(&self) -> Result<CameraPath> {
        let text = self.path_text();
        let text = text.to_str().with_context(|| format!("{} is no UTF-8", text.display()))?;
        let spec: PathSpec = text.parse()?;
        Ok(spec.load()?)
    }

    /// Returns the scene's name in tables: its file name without the extension.
    pub fn scene_name(&self) -> String {
        self.file.scene.file_stem().unwrap_or_default().to_string_lossy().into_owned()
    }

    /// Returns the path of a result; creates the folder.
    pub fn result(&self, name: &str) -> Result<PathBuf> {
        fs::create_dir_all(&self.out).with_context(|| format!("creating {}", self.out.display()))?;
        Ok(self.out.join(name))
    }

    /// Returns the path of the written file.
    pub fn write(&self, name: &str, text: &str) -> Result<PathBuf> {
        let file = self.result(name)?;
        fs::write(&file, text).with_context(|| format!("writing {}", file.display()))?;
        Ok(file)
    }
}

/// Parses a report's options as `lab` does.
pub fn parse<T: clap::Args>(line: &str) -> Result<T> {
    let command = T::augment_args(clap::Command::new("lab").no_binary_name(true));
    Ok(T::from_arg_matches(&command.try_get_matches_from(line.split_whitespace())?)?)
}

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
