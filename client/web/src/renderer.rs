//! A scene's renderer: first what the adapter works on, then what is computed meanwhile.

use gnomon_client_core::{
    occluders::Occluders,
    predictor::Predictor,
    render::{
        FrameRenderer, PICTURE_FORMAT, RenderError, environment::Environment, exposure::Exposure, quality::Quality,
        survey::Survey, tone::ToneCurve,
    },
};
use gnomon_scene::{Scene, camera::Camera};
use gnomon_shaders::gpu::Gpu;

use crate::options::Options;

/// Uploads a scene, and compiles what its first pictures take: drafts, unless a walk's pictures are wanted as they are.
///
/// # Errors
/// If the scene or the picture exceeds a limit of the adapter, or the adapter fails.
pub fn new_renderer(
    gpu: &Gpu,
    scene: &Scene,
    size: (u32, u32),
    options: &Options,
) -> Result<FrameRenderer, RenderError> {
    // How bright the scene is will be found out while the adapter compiles.
    let exposure = Exposure::for_reference(1.0);
    let mut renderer = FrameRenderer::new(gpu, scene, size, exposure, PICTURE_FORMAT, Predictor::default())?;
    renderer.set_tone(ToneCurve::default());
    renderer.set_quality(Quality::default());
    renderer.set_draft(options.walk.is_none());
    renderer.compile();
    Ok(renderer)
}

/// Gives a new renderer its light, as bright as what `camera` sees wants, or `exposure` says. `scene` is as it is at
/// that time, in seconds.
pub(crate) fn light(
    renderer: &mut FrameRenderer,
    scene: &Scene,
    occluders: &Occluders,
    (camera, scene_time_s): (&Camera, f64),
    exposure: Option<f32>,
) {
    renderer.set_time(scene_time_s);
    let survey = Survey::new(scene, occluders, camera);
    let first = Exposure::for_reference(survey.lux);
    renderer.set_exposure(exposure.map_or(first, |ev| first.at_ev(ev)));
    renderer.set_environment(Environment::Sky, survey);
}
