//! Pictures with late visibility, without a network or clock: the cpu back end traces the mask of one view, the
//! client's renderer predicts another view from it, and the referee has the truth.

use std::cell::OnceCell;

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
use gnomon_scene::{Animation, Scene, SceneAt, camera::Camera};
use gnomon_server::visibility::backend::cpu::CpuBackend;
use gnomon_shaders::gpu::{Gpu, GpuOptions};
use image::RgbImage;

use super::prediction_error::near_movers;
use crate::reference::{Point, Reference, Truth};

/// Returns the scene without the pieces that move; its lights still do. `None` if no piece does.
fn without_pieces(scene: &Scene) -> Option<Scene> {
    let animation = scene.animation.as_deref().filter(|animation| !animation.pieces.is_empty())?;
    let mut scene = scene.clone();
    // A draw is one instance's, so all of it moves or rests.
    scene.draws.retain(|draw| {
        let first = scene.triangles.get(draw.first_triangle as usize);
        first.is_none_or(|corners| animation.piece_of(corners[0]).is_none())
    });
    let moves = !animation.lights.is_empty();
    let bare = || Animation { pieces: Vec::new(), shapes: Vec::new(), ..animation.clone() };
    scene.animation = moves.then(|| Box::new(bare()));
    Some(scene)
}

/// A referee of a scene at a time, prepared when it is asked.
struct Judge {
    scene: Scene,
    now_s: f64,
    reference: OnceCell<Reference>,
}

impl Judge {
    fn new(scene: Scene) -> Self {
        Self { scene, now_s: 0.0, reference: OnceCell::new() }
    }

    fn set_time(&mut self, now_s: f64) {
        if self.scene.animation.is_some() {
            (self.now_s, self.reference) = (now_s, OnceCell::new());
        }
    }

    fn now(&self) -> &Reference {
        self.reference.get_or_init(|| Reference::at(&self.scene, self.now_s))
    }
}

pub(super) struct PredictRig {
    lights: u32,
    backend: CpuBackend,
    judge: Judge,
    /// Of the scene without the pieces that move. `None` if only lights do, or nothing.
    without: Option<Judge>,
    moves: bool,
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
            judge: Judge::new(scene.clone()),
            without: without_pieces(scene).map(Judge::new),
            moves: scene.animation.is_some(),
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
        [Some(&mut self.judge), self.without.as_mut()].into_iter().flatten().for_each(|judge| judge.set_time(now_s));
    }

    /// Traces masks at this time of the scene from now on, until [`Self::set_time`].
    pub(super) fn set_mask_time(&mut self, then_s: f64) {
        self.then_s = then_s;
    }

    pub(super) fn truth(&self, camera: &Camera) -> Truth {
        self.judge.now().trace(camera)
    }

    pub(super) fn points(&self, camera: &Camera) -> Vec<Option<Point>> {
        self.judge.now().points(camera)
    }

    /// Returns which pixels are near what moves. `None` if no piece does. `truth` is the camera's.
    pub(super) fn near_movers(&self, camera: &Camera, truth: &Truth) -> Option<Vec<bool>> {
        let without = self.without.as_ref()?.now();
        let bare = (without.trace(camera), without.points(camera));
        Some(near_movers((truth, &self.points(camera)), (&bare.0, &bare.1)))
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
        let scene = SceneAt::from(if self.moves { self.then_s } else { 0.0 });
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
