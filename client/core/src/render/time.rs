//! When pictures are of: what moves follows the time of the scene.

use gnomon_scene::camera::Camera;

use super::{movers::Movers, renderer::FrameRenderer};
use crate::camera::Viewpoint;

impl FrameRenderer {
    /// Whether something moves in the scene, other than cameras.
    #[must_use]
    pub fn moves(&self) -> bool {
        self.scene.movers().is_some()
    }

    /// Shows the scene as it is at this time, in seconds, from the next picture on. At first it is 0.
    pub fn set_time(&mut self, scene_time_s: f64) {
        let Some(lights) = self.scene.set_time(scene_time_s) else { return };
        self.lights = lights;
        self.predict.set_lights(&self.gpu, &self.lights);
        if self.surroundings.follow(&self.gpu, &self.lights) {
            self.shade.bind(&self.gpu.device, &self.targets, &self.history, &self.surroundings);
        }
    }

    /// What a picture for `camera` shows.
    pub(super) fn seen(&self, camera: Camera) -> Viewpoint {
        Viewpoint { camera, scene_time_s: self.scene.movers().map_or(0.0, Movers::time_s) }
    }
}
