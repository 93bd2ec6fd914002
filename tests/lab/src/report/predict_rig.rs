//! Pictures with late visibility, without a network or clock: the cpu back end traces the mask of one view, the
//! client's renderer predicts another view from it, and the referee has the truth.

use anyhow::{Context, Result};
use gnomon_client::{
    occluders::Occluders,
    predictor::Predictor,
    render::{
        FrameRenderer, PICTURE_FORMAT, PixelVisibility,
        exposure::Exposure,
        predict::MaskView,
        readback::{Picture, PictureReader},
    },
};
use gnomon_protocol::mask::{Mask, MaskShape};
use gnomon_scene::{Scene, SceneAt, camera::Camera};
use gnomon_server::visibility::backend::cpu::CpuBackend;
use gnomon_shaders::gpu::{Gpu, GpuOptions};
use image::RgbImage;

use crate::reference::{Point, Reference, Truth};

pub(super) struct PredictRig {
    lights: u32,
    backend: CpuBackend,
    reference: Reference,
    /// `None` if everything rests.
    moving: Option<Scene>,
    /// Times of the scene, in seconds: of pictures, and of masks.
    now_s: f64,
    then_s: f64,
    renderer: FrameRenderer,
    pictures: PictureReader,
}

impl PredictRig {
    pub(super) fn new(scene: &Scene, size: (u32, u32), allow_software: bool) -> Result<Self> {
        let gpu = GpuOptions { allow_software, ..GpuOptions::default() };
        let gpu = pollster::block_on(Gpu::open(&gpu))?;
        let exposure = Exposure::of_scene(scene, &Occluders::largest_of(scene));
        Ok(Self {
            lights: u32::try_from(scene.lights.len()).context("more lights than a mask has")?,
            backend: CpuBackend::new(scene, None)?,
            reference: Reference::new(scene),
            moving: scene.animation.is_some().then(|| scene.clone()),
            now_s: 0.0,
            then_s: 0.0,
            renderer: FrameRenderer::new(&gpu, scene, size, exposure, PICTURE_FORMAT, Predictor::Surface)?,
            pictures: PictureReader::new(&gpu, size.0, size.1, 1),
        })
    }

    /// Draws and judges pictures, and traces masks, at this time of the scene from now on; 0 at first.
    pub(super) fn set_time(&mut self, now_s: f64) {
        (self.now_s, self.then_s) = (now_s, now_s);
        self.renderer.set_time(now_s);
        if let Some(scene) = &self.moving {
            self.reference = Reference::at(scene, now_s);
        }
    }

    /// Traces masks at this time of the scene from now on, until [`Self::set_time`].
    pub(super) fn set_mask_time(&mut self, then_s: f64) {
        self.then_s = then_s;
    }

    pub(super) fn truth(&self, camera: &Camera) -> Truth {
        self.reference.trace(camera)
    }

    pub(super) fn points(&self, camera: &Camera) -> Vec<Option<Point>> {
        self.reference.points(camera)
    }

    /// For settings of pictures.
    pub(super) fn renderer(&mut self) -> &mut FrameRenderer {
        &mut self.renderer
    }

    /// Returns the mask that a server would send for a view.
    pub(super) fn trace(&self, camera: &Camera) -> Result<Mask> {
        let mut mask = Mask::new(MaskShape::new(camera.width, camera.height, self.lights)?);
        let (rows, posed) = (0..mask.shape().tiles_y(), self.backend.pose(self.then_s));
        self.backend.trace_rows(camera, &mut mask, rows, posed.as_ref());
        Ok(mask)
    }

    /// Without lag. Blended surfaces ask shadow maps, which only this predictor draws.
    pub(super) fn true_picture(&mut self, camera: &Camera) -> Result<RgbImage> {
        let mask = self.trace(camera)?;
        Ok(self.draw(camera, Predictor::Surface, Some((&mask, camera)))?.0)
    }

    /// Returns the client's picture and visibility for a view. `mask` comes with the view that it was traced for.
    pub(super) fn draw(
        &mut self,
        camera: &Camera,
        predictor: Predictor,
        mask: Option<(&Mask, &Camera)>,
    ) -> Result<(RgbImage, Vec<PixelVisibility>)> {
        let picture = self.shade(camera, predictor, mask, true)?.context("the picture has not come back")?;
        let rgb = picture.rgba.as_chunks::<4>().0.iter().flat_map(|[r, g, b, _]| [*r, *g, *b]).collect();
        let picture = RgbImage::from_raw(picture.width, picture.height, rgb).context("a picture of another size")?;
        Ok((picture, self.renderer.read_visibility()?))
    }

    /// Draws without reading the picture back; returns when the GPU is done.
    pub(super) fn show(&mut self, camera: &Camera, predictor: Predictor, mask: Option<(&Mask, &Camera)>) -> Result<()> {
        self.shade(camera, predictor, mask, false).map(|_| ())
    }

    /// Draws a view, which puts its depth into the renderer's history.
    pub(super) fn see(&mut self, camera: &Camera) -> Result<()> {
        self.show(camera, Predictor::None, None)
    }

    fn shade(
        &mut self,
        camera: &Camera,
        predictor: Predictor,
        mask: Option<(&Mask, &Camera)>,
        copied: bool,
    ) -> Result<Option<Picture>> {
        let scene = SceneAt::from(if self.moving.is_some() { self.then_s } else { 0.0 });
        self.renderer.set_predictor(predictor);
        self.renderer.draw_surfaces(camera)?;
        self.renderer.set_mask(mask.map(|(mask, traced_for)| MaskView {
            mask,
            coverage: None,
            more: false,
            traced_for,
            scene: &scene,
        }))?;
        let target = self.pictures.target();
        let submission = self.renderer.shade(camera, 1.0, &target, |encoder| {
            if copied {
                self.pictures.copy(encoder);
            }
        })?;
        self.pictures.submitted(0, submission, copied);
        Ok(self.pictures.take_oldest()?.flatten())
    }

    /// Share of the last picture's pixels that the mask covered.
    pub(super) fn known_share(&mut self) -> Option<f64> {
        self.renderer.known_share()
    }
}
