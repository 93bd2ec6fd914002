//! The page's canvas, and the adapter that draws on it.

use std::sync::{
    Arc,
    atomic::{AtomicBool, AtomicU32, Ordering},
};

use gnomon_client_core::render::{
    FrameRenderer, PICTURE_FORMAT, RenderError,
    readback::{Picture, PictureReader},
};
use gnomon_scene::camera::Camera;
use gnomon_shaders::gpu::{Gpu, GpuError, GpuOptions};
use thiserror::Error;
use web_sys::OffscreenCanvas;

/// Pictures that the adapter may still be drawing: with more, a slow one would show what was long ago.
const MOST_UNDER_WAY: u32 = 2;

#[derive(Debug, Error)]
pub(crate) enum ScreenError {
    #[error("the canvas gives no surface: {0}")]
    Surface(#[from] wgpu::CreateSurfaceError),
    #[error("no graphics adapter: {0}")]
    Adapter(#[from] wgpu::RequestAdapterError),
    #[error(transparent)]
    Gpu(#[from] GpuError),
    #[error("the adapter cannot present on a canvas")]
    Unsuitable,
}

pub(crate) struct Screen {
    pub(crate) gpu: Gpu,
    canvas: OffscreenCanvas,
    surface: wgpu::Surface<'static>,
    config: wgpu::SurfaceConfiguration,
    picture: Option<Saving>,
    under_way: Arc<AtomicU32>,
}

/// A picture on its way to the page.
struct Saving {
    reader: PictureReader,
    arrived: Arc<AtomicBool>,
    /// What the page calls it.
    number: u32,
    /// False until it is drawn.
    drawn: bool,
}

impl Screen {
    /// Opens the browser's adapter, software if there is no other.
    pub(crate) async fn open(canvas: OffscreenCanvas) -> Result<Self, ScreenError> {
        let instance = wgpu::Instance::new(wgpu::InstanceDescriptor {
            backends: wgpu::Backends::BROWSER_WEBGPU,
            ..wgpu::InstanceDescriptor::new_without_display_handle()
        });
        let surface = instance.create_surface(wgpu::SurfaceTarget::OffscreenCanvas(canvas.clone()))?;
        let wanted = wgpu::RequestAdapterOptions {
            power_preference: wgpu::PowerPreference::HighPerformance,
            compatible_surface: Some(&surface),
            ..wgpu::RequestAdapterOptions::default()
        };
        let adapter = instance.request_adapter(&wanted).await?;
        let default = surface.get_default_config(&adapter, canvas.width().max(1), canvas.height().max(1));
        // Pictures are encoded already, so that the format is that of pictures everywhere.
        let config = wgpu::SurfaceConfiguration {
            format: PICTURE_FORMAT,
            view_formats: Vec::new(),
            ..default.ok_or(ScreenError::Unsuitable)?
        };
        let options = GpuOptions { allow_software: true, ..GpuOptions::default() };
        let gpu = Gpu::from_adapters(vec![adapter], &options).await?;
        surface.configure(&gpu.device, &config);
        Ok(Self { gpu, canvas, surface, config, picture: None, under_way: Arc::default() })
    }

    /// In pixels.
    pub(crate) fn size(&self) -> (u32, u32) {
        (self.config.width, self.config.height)
    }

    /// Ignores a canvas without area.
    pub(crate) fn resize(&mut self, (width, height): (u32, u32)) {
        if width > 0 && height > 0 && (width, height) != self.size() {
            self.canvas.set_width(width);
            self.canvas.set_height(height);
            (self.config.width, self.config.height) = (width, height);
            self.surface.configure(&self.gpu.device, &self.config);
        }
    }

    /// The next picture goes to [`Self::take_picture`], and the canvas keeps the last one.
    pub(crate) fn save_picture(&mut self, number: u32) {
        if self.picture.is_none() {
            let (width, height) = self.size();
            let reader = PictureReader::new(&self.gpu, width, height, 1);
            self.picture = Some(Saving { reader, arrived: Arc::default(), number, drawn: false });
        }
    }

    /// Returns whether a picture is on its way.
    pub(crate) fn is_saving(&self) -> bool {
        self.picture.is_some()
    }

    /// Returns the saved picture and its number, once it has arrived.
    pub(crate) fn take_picture(&mut self) -> Option<(u32, Picture)> {
        let mut saving = self.picture.take_if(|saving| saving.arrived.load(Ordering::Acquire))?;
        let picture = saving.reader.take_oldest().ok()??;
        picture.map(|picture| (saving.number, picture))
    }

    /// Returns whether the adapter has drawn enough to be given more.
    pub(crate) fn is_ready(&self) -> bool {
        self.under_way.load(Ordering::Acquire) < MOST_UNDER_WAY
    }

    /// Returns whether the adapter has drawn all that it was given.
    pub(crate) fn is_idle(&self) -> bool {
        self.under_way.load(Ordering::Acquire) == 0
    }

    /// Shades a frame's surfaces ([`FrameRenderer::shade`]) and shows the picture.
    pub(crate) fn show(
        &mut self,
        renderer: &mut FrameRenderer,
        camera: &Camera,
        visibility_share: f32,
    ) -> Result<(), RenderError> {
        // A picture asked for before the canvas changed is never drawn.
        self.picture.take_if(|saving| !saving.drawn && saving.reader.size() != renderer.size());
        let fits = |saving: &&mut Saving| !saving.drawn;
        if let Some(saving) = self.picture.as_mut().filter(fits) {
            let target = saving.reader.target();
            let submission =
                renderer.shade(camera, visibility_share, &target, |encoder| saving.reader.copy(encoder))?;
            saving.reader.submitted(0, submission, true);
            saving.drawn = true;
            // Callbacks come in order: when this one does, the copy is there.
            let arrived = Arc::clone(&saving.arrived);
            self.gpu.queue.on_submitted_work_done(move || arrived.store(true, Ordering::Release));
            return Ok(());
        }
        use wgpu::CurrentSurfaceTexture as Current;
        let texture = match self.surface.get_current_texture() {
            Current::Success(texture) | Current::Suboptimal(texture) => texture,
            Current::Outdated | Current::Lost => {
                self.surface.configure(&self.gpu.device, &self.config);
                return Ok(());
            }
            // Nothing is visible, or the next attempt succeeds.
            Current::Timeout | Current::Occluded | Current::Validation => return Ok(()),
        };
        let view = texture.texture.create_view(&wgpu::TextureViewDescriptor::default());
        renderer.shade(camera, visibility_share, &view, |_| ())?;
        self.gpu.queue.present(texture);
        let under_way = Arc::clone(&self.under_way);
        under_way.fetch_add(1, Ordering::AcqRel);
        self.gpu.queue.on_submitted_work_done(move || {
            under_way.fetch_sub(1, Ordering::AcqRel);
        });
        Ok(())
    }
}
