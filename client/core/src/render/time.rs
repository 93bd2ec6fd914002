//! When pictures are of: what moves follows the time of the scene, and what people have changed in it.

use gnomon_scene::{SceneAt, camera::Camera};

use super::{movers::Movers, renderer::FrameRenderer, work::Work};
use crate::camera::Viewpoint;

impl FrameRenderer {
    /// Whether something in the scene moves with time, other than cameras.
    #[must_use]
    pub fn moves(&self) -> bool {
        self.scene.moves_with_time
    }

    /// Shows this state of the scene from the next picture on; a number is a time in seconds. At first it is time 0,
    /// and nothing is edited.
    pub fn set_time(&mut self, scene: impl Into<SceneAt>) {
        let scene = scene.into();
        let scene = if self.moves() { scene } else { scene.at_any_time() };
        if !scene.edits.is_empty() {
            self.scene.follow_edits(&self.lights, self.space.origin_m);
        }
        let Some(lights) = self.scene.set_time(&scene) else { return };
        self.lights = lights;
        self.predict.set_lights(&self.gpu, &self.lights);
        if self.surroundings.follow(&self.gpu, &self.lights) {
            self.shade.bind(&self.gpu.device, &self.targets, &self.history, &self.surroundings);
        }
    }

    /// What shadow maps and what moves took so far.
    #[must_use]
    pub fn work(&self) -> Work {
        let bytes = self.scene.movers().map_or(0, |movers| movers.copied_bytes);
        self.predict.work() + Work { bytes, ..Work::default() }
    }

    /// What a picture for `camera` shows.
    pub(super) fn seen(&self, camera: Camera) -> Viewpoint {
        Viewpoint { camera, scene: self.scene.movers().map(Movers::scene).unwrap_or_default() }
    }
}
