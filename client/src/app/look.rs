//! How a run's pictures begin to look: the light around, the tone curve, and an exposure for the first camera.

use gnomon_scene::{Scene, camera::Camera};

use crate::{
    config::ClientSettings,
    occluders::Occluders,
    render::{FrameRenderer, RenderError, environment::Environment, exposure::Exposure, survey::Survey},
};

/// What is found out about a scene before it is drawn.
pub(crate) struct Look {
    environment: Environment,
    survey: Survey,
    /// Where the run begins, and when, in seconds of the scene.
    camera: Camera,
    scene_time_s: f64,
}

impl Look {
    /// `scene` is as it is at the time at which `camera` sees it.
    pub(crate) fn new(
        environment: Environment,
        scene: &Scene,
        occluders: &Occluders,
        (camera, scene_time_s): (Camera, f64),
    ) -> Self {
        let survey = Survey::new(scene, occluders, &camera);
        Self { environment, survey, camera, scene_time_s }
    }

    /// Returns the exposure to make a renderer with.
    pub(crate) fn first_exposure(&self) -> Exposure {
        Exposure::for_reference(self.survey.lux)
    }

    /// Gives a new renderer its look. Returns the requested exposure, or the one that suits the first camera.
    ///
    /// # Errors
    /// If the adapter fails.
    pub(crate) fn apply(
        self,
        renderer: &mut FrameRenderer,
        settings: &ClientSettings,
    ) -> Result<Exposure, RenderError> {
        renderer.set_time(self.scene_time_s);
        renderer.set_tone(settings.tone);
        renderer.set_environment(self.environment, self.survey);
        match settings.exposure {
            Some(ev) => renderer.set_exposure(Exposure::for_reference(self.survey.lux).at_ev(ev)),
            None => renderer.meter(&self.camera, settings.predict)?,
        }
        Ok(renderer.exposure())
    }
}
