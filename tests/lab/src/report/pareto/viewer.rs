//! The client's side of a measurement: the bits that pixels are shaded with, and the picture.

use anyhow::{Context, Result};
use gnomon_client::{
    occluders::Occluders,
    predictor::Predictor,
    render::{FrameRenderer, PICTURE_FORMAT, exposure::Exposure, predict::MaskView, readback::PictureReader},
};
use gnomon_protocol::mask::{Mask, MaskShape};
use gnomon_scene::{Scene, SceneAt, camera::Camera};
use gnomon_shaders::gpu::{Gpu, GpuOptions};
use image::RgbImage;

pub(super) struct Viewer {
    renderer: FrameRenderer,
    reader: PictureReader,
    lights: u32,
}

pub(super) struct Shown {
    /// The bits that pixels were shaded with, after prediction.
    pub(super) bits: Mask,
    pub(super) picture: RgbImage,
}

impl Viewer {
    pub(super) fn new(scene: &Scene, size: (u32, u32)) -> Result<Self> {
        let gpu = pollster::block_on(Gpu::open(&GpuOptions { allow_software: true, ..GpuOptions::default() }))?;
        let exposure = Exposure::of_scene(scene, &Occluders::largest_of(scene));
        let renderer = FrameRenderer::new(&gpu, scene, size, exposure, PICTURE_FORMAT, Predictor::Surface)?;
        let lights = u32::try_from(scene.lights.len()).context("more lights than a mask has")?;
        Ok(Self { renderer, reader: PictureReader::new(&gpu, size.0, size.1, 1), lights })
    }

    /// Draws the frame that `camera` sees when the newest mask is `mask`, which was traced for `traced_for`.
    pub(super) fn show(
        &mut self,
        camera: &Camera,
        (mask, traced_for): (&Mask, &Camera),
        predictor: Predictor,
    ) -> Result<Shown> {
        self.renderer.set_predictor(predictor);
        self.renderer.draw_surfaces(camera)?;
        let used = self.renderer.set_mask(Some(MaskView {
            mask,
            coverage: None,
            more: false,
            traced_for,
            scene: &SceneAt::default(),
        }))?;
        anyhow::ensure!(used, "the client does not take a mask of {:?}", mask.shape());
        let target = self.reader.target();
        let submission = self.renderer.shade(camera, 1.0, &target, |encoder| self.reader.copy(encoder))?;
        self.reader.submitted(0, submission, true);
        let picture = self.reader.take_oldest()?.flatten().context("a picture that was drawn did not come back")?;
        let mut bits = Mask::new(MaskShape::new(camera.width, camera.height, self.lights)?);
        let pixels = (0..camera.height).flat_map(|y| (0..camera.width).map(move |x| (y, x)));
        for (pixel, (y, x)) in self.renderer.read_visibility()?.iter().zip(pixels) {
            for light in (0..self.lights).filter(|light| pixel.word >> light & 1 == 1) {
                bits.set(light, x, y, true);
            }
        }
        let rgb = picture.rgba.chunks_exact(4).flat_map(|texel| [texel[0], texel[1], texel[2]]).collect();
        let picture = RgbImage::from_raw(picture.width, picture.height, rgb).context("a picture of another size")?;
        Ok(Shown { bits, picture })
    }
}
