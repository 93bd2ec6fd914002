//! The window's surface. Pictures are drawn to a texture, as in a headless run, and then presented.

use std::{path::PathBuf, sync::Arc, thread::JoinHandle, time::Instant};

use gnomon_protocol::ids::FrameNumber;
use gnomon_scene::camera::Camera;
use gnomon_shaders::gpu::{Gpu, GpuError, GpuOptions};
use winit::window::Window;

use super::painter::{Painter, Shapes};
use crate::{
    error::ClientError,
    frame_driver::{Shown, Sink},
    headless::pictures,
    render::{FrameRenderer, RenderError, readback::PictureReader},
};

/// Pictures in flight on the adapter.
const PICTURES_AHEAD: usize = 2;

pub(crate) struct Screen {
    pub(crate) gpu: Gpu,
    window: Arc<Window>,
    surface: wgpu::Surface<'static>,
    config: wgpu::SurfaceConfiguration,
    painter: Painter,
    reader: Option<PictureReader>,
    /// A picture of the same size, and the first column from which it replaces the next picture.
    pub(crate) right_half: Option<(wgpu::Texture, u32)>,
    pub(crate) shapes: Shapes,
    /// File for the next picture.
    save_next: Option<PathBuf>,
    /// The frame being read back, and its file.
    reading: Option<(u64, PathBuf)>,
    saving: Option<JoinHandle<Result<PathBuf, ClientError>>>,
}

impl Screen {
    /// Opens an adapter that can present in `window`.
    pub(crate) fn open(window: &Arc<Window>, options: &GpuOptions, vsync: bool) -> Result<Self, ClientError> {
        let instance = wgpu::Instance::new(wgpu::InstanceDescriptor {
            backends: wgpu::Backends::PRIMARY,
            ..wgpu::InstanceDescriptor::new_without_display_handle_from_env()
        });
        let surface =
            instance.create_surface(Arc::clone(window)).map_err(|error| RenderError::Device(error.to_string()))?;
        let mut adapters = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::PRIMARY));
        adapters.retain(|adapter| adapter.is_surface_supported(&surface));
        let gpu = pollster::block_on(Gpu::from_adapters(adapters.clone(), options))?;
        let no_adapter = || GpuError::NoAdapter { wanted: options.adapter.clone(), found: vec![gpu.info.name.clone()] };
        let adapter = adapters.iter().find(|adapter| adapter.get_info() == gpu.info).ok_or_else(no_adapter)?;
        let capabilities = surface.get_capabilities(adapter);
        // The passes encode, so an sRGB format would encode twice.
        let format = [wgpu::TextureFormat::Bgra8Unorm, wgpu::TextureFormat::Rgba8Unorm]
            .into_iter()
            .find(|format| capabilities.formats.contains(format))
            .ok_or_else(|| RenderError::Device("the window supports no 8-bit format".to_owned()))?;
        let size = window.inner_size();
        let config = wgpu::SurfaceConfiguration {
            present_mode: present_mode(vsync),
            desired_maximum_frame_latency: 1,
            ..surface
                .get_default_config(adapter, size.width.max(1), size.height.max(1))
                .map(|config| wgpu::SurfaceConfiguration { format, view_formats: Vec::new(), ..config })
                .ok_or_else(|| RenderError::Device("the adapter cannot present in this window".to_owned()))?
        };
        surface.configure(&gpu.device, &config);
        let painter = Painter::new(&gpu, format)?;
        Ok(Self {
            gpu,
            window: Arc::clone(window),
            surface,
            config,
            painter,
            reader: None,
            right_half: None,
            shapes: Shapes::default(),
            save_next: None,
            reading: None,
            saving: None,
        })
    }

    /// In pixels.
    pub(crate) fn size(&self) -> (u32, u32) {
        (self.config.width, self.config.height)
    }

    /// Follows the window's size. Ignores a window without area.
    pub(crate) fn resize(&mut self, (width, height): (u32, u32)) {
        if width > 0 && height > 0 && (width, height) != self.size() {
            (self.config.width, self.config.height) = (width, height);
            self.surface.configure(&self.gpu.device, &self.config);
        }
    }

    pub(crate) fn set_vsync(&mut self, vsync: bool) {
        let mode = present_mode(vsync);
        if self.config.present_mode != mode {
            self.config.present_mode = mode;
            self.surface.configure(&self.gpu.device, &self.config);
        }
    }

    /// Saves the next picture in `file`, unless an earlier one is still being saved.
    pub(crate) fn save_picture(&mut self, file: PathBuf) {
        if self.save_next.is_none() && self.reading.is_none() && self.saving.is_none() {
            self.save_next = Some(file);
        }
    }

    /// Returns the file of a picture saved since the last call, or why saving failed.
    pub(crate) fn poll_saved(&mut self) -> Option<Result<PathBuf, ClientError>> {
        self.saving.take_if(|saving| saving.is_finished()).map(joined)
    }

    /// Waits until the picture being saved is written.
    pub(crate) fn finish(&mut self) -> Option<Result<PathBuf, ClientError>> {
        while self.reading.is_some() && matches!(self.take_oldest(), Ok(true)) {}
        self.saving.take().map(joined)
    }

    /// Presents the overlay without a picture.
    pub(crate) fn show_overlay(&mut self) {
        self.present(None);
    }

    /// Waits for the oldest picture in flight. Returns whether there was one.
    fn take_oldest(&mut self) -> Result<bool, ClientError> {
        let Some(taken) = self.reader.as_mut().map(PictureReader::take_oldest).transpose()?.flatten() else {
            return Ok(false);
        };
        if let Some(picture) = taken
            && let Some((_, file)) = self.reading.take_if(|(frame, _)| *frame == picture.frame)
        {
            let write = move || {
                let written = pictures::write(&file, &picture);
                written.map(|()| file.clone()).map_err(|source| ClientError::Write { path: file, source })
            };
            self.saving = Some(std::thread::Builder::new().name("png".to_owned()).spawn(write)?);
        }
        Ok(true)
    }

    fn present(&mut self, picture: Option<&wgpu::TextureView>) {
        use wgpu::CurrentSurfaceTexture as Current;
        let texture = match self.surface.get_current_texture() {
            Current::Success(texture) | Current::Suboptimal(texture) => texture,
            Current::Outdated | Current::Lost => {
                self.surface.configure(&self.gpu.device, &self.config);
                return;
            }
            // Nothing is visible, or the next attempt succeeds.
            Current::Timeout | Current::Occluded | Current::Validation => return,
        };
        let view = texture.texture.create_view(&wgpu::TextureViewDescriptor::default());
        let size = (texture.texture.width(), texture.texture.height());
        self.painter.paint(&view, size, picture, &mut self.shapes);
        self.window.pre_present_notify();
        self.gpu.queue.present(texture);
    }
}

impl Sink for Screen {
    fn show(
        &mut self,
        frame: FrameNumber,
        renderer: &mut FrameRenderer,
        camera: &Camera,
        visibility_share: f32,
    ) -> Result<Shown, ClientError> {
        let begun = Instant::now();
        let (width, height) = renderer.size();
        if self.reader.as_ref().is_none_or(|reader| reader.size() != (width, height)) {
            // A picture requested before the window changed is saved in its new size.
            if let Some((_, file)) = self.reading.take() {
                self.save_next = Some(file);
            }
            self.reader = Some(PictureReader::new(&self.gpu, width, height, PICTURES_AHEAD));
        }
        let Some(reader) = &mut self.reader else { return Ok(Shown::default()) };
        let target = reader.target();
        let save = self.save_next.take();
        let right_half = self.right_half.take();
        let submission = renderer.shade(camera, visibility_share, &target, |encoder| {
            if let Some((other, first_px)) = &right_half {
                reader.replace_from(encoder, other, *first_px);
            }
            if save.is_some() {
                reader.copy(encoder);
            }
        })?;
        reader.submitted(frame.0.into(), submission, save.is_some());
        self.reading = save.map(|file| (frame.0.into(), file)).or(self.reading.take());
        let shade = begun.elapsed();
        self.present(Some(&target));
        while self.reader.as_ref().is_some_and(PictureReader::is_full) {
            self.take_oldest()?;
        }
        Ok(Shown { shade, readback: begun.elapsed().saturating_sub(shade) })
    }
}

fn joined(saving: JoinHandle<Result<PathBuf, ClientError>>) -> Result<PathBuf, ClientError> {
    saving.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
}

fn present_mode(vsync: bool) -> wgpu::PresentMode {
    if vsync { wgpu::PresentMode::AutoVsync } else { wgpu::PresentMode::AutoNoVsync }
}
