//! Command-line options for an example's scene and camera.

use std::path::PathBuf;

use anyhow::{Context, Result};
use glam::DVec3;
use gnomon_scene::{LoadOptions, Scene, camera::Camera};

#[derive(Debug, clap::Args)]
pub(crate) struct ViewArguments {
    /// The scene: .gltf or .glb.
    pub(crate) scene: PathBuf,
    /// Lights for a scene that has none.
    #[arg(long)]
    lights_from: Option<PathBuf>,
    /// Position of the camera, in metres.
    #[arg(long, default_value = "-8.5,1.7,-0.35", value_parser = point, allow_hyphen_values = true)]
    from: DVec3,
    /// Point that the camera looks at, in metres.
    #[arg(long, default_value = "0,1.7,-0.35", value_parser = point, allow_hyphen_values = true)]
    to: DVec3,
    /// Full vertical field of view, in degrees.
    #[arg(long, default_value_t = 60.0)]
    yfov: f64,
}

impl ViewArguments {
    pub(crate) fn load(&self, max_lights: Option<u32>) -> Result<Scene> {
        Ok(Scene::load(
            &self.scene,
            &LoadOptions { lights_from: self.lights_from.clone(), max_lights, ..LoadOptions::default() },
        )?)
    }

    pub(crate) fn camera(&self, size: (u32, u32)) -> Camera {
        self.looking((self.from, self.to), size)
    }

    /// A camera with this field of view at another place.
    pub(crate) fn looking(&self, (from, to): (DVec3, DVec3), (width, height): (u32, u32)) -> Camera {
        Camera::looking_at(from, to, self.yfov.to_radians(), width, height)
    }
}

pub(crate) fn size(text: &str) -> Result<(u32, u32)> {
    let (width, height) = text.split_once('x').context("a size is WIDTHxHEIGHT")?;
    Ok((width.parse()?, height.parse()?))
}

fn point(text: &str) -> Result<DVec3> {
    let numbers: Vec<f64> = text.split(',').map(str::parse).collect::<Result<_, _>>()?;
    let numbers: [f64; 3] = numbers.try_into().ok().context("a point is X,Y,Z")?;
    Ok(DVec3::from_array(numbers))
}

#[allow(dead_code, reason = "not all of the examples have several views")]
pub(crate) fn from_to(text: &str) -> Result<(DVec3, DVec3)> {
    let (from, to) = text.split_once(':').context("a view is FROM:TO")?;
    Ok((point(from)?, point(to)?))
}
