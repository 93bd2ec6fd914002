//! The window's surface, and where its pictures go: the same texture as a headless run's, then onto the screen.

use std::{path::PathBuf, sync::Arc, thread::JoinHandle, time::Instant};

use gnomon_protocol::ids::FrameNumber;
use gnomon_scene::camera::Camera;
use gnomon_shaders::gpu::{Gpu, GpuError, GpuOptions};
use winit::window::Window;

use super::painter::{Painter, Shapes};
use crate::{
    error::ClientError,
    frame_loop::{Shown, Sink},
    headless::pictures,
    render::{FrameRenderer, RenderError, readback::PictureReader},
};

/// Pictures that may be under way on the adapter.
const PICTURES_AHEAD: usize = 2;

/// The screen of one window.
pub(crate) struct Screen {
    pub(crate) gpu: Gpu,
    window: Arc<Window>,
    surface: wgpu::Surface<'static>,
    config: wgpu::SurfaceConfiguration,
    painter: Painter,
    reader: Option<PictureReader>,
    /// A picture of the same size, whose columns from this one on stand in the next picture.
    pub(crate) beside: Option<(wgpu::Texture, u32)>,
    pub(crate) shapes: Shapes,
    /// Where the next picture shall be kept, and the frame whose picture is on its way there.
    keep: Option<PathBuf>,
    kept: Option<(u64, PathBuf)>,
    saving: Option<JoinHandle<Result<PathBuf, String>>>,
}

impl Screen {
    /// Opens the adapter that shows things in `window`.
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
            .ok_or_else(|| RenderError::Device("the window takes no 8-bit format".to_owned()))?;
        let size = window.inner_size();
        let config = wgpu::SurfaceConfiguration {
            present_mode: present_mode(vsync),
            desired_maximum_frame_latency: 1,
            ..surface
                .get_default_config(adapter, size.width.max(1), size.height.max(1))
                .map(|config| wgpu::SurfaceConfiguration { format, view_formats: Vec::new(), ..config })
                .ok_or_else(|| RenderError::Device("the adapter does not show things in this window".to_owned()))?
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
            beside: None,
            shapes: Shapes::default(),
            keep: None,
            kept: None,
            saving: None,
        })
    }

    /// Width and height, in pixels.
    pub(crate) fn size(&self) -> (u32, u32) {
        (self.config.width, self.config.height)
    }

    /// Follows the window. A window without any area is left alone.
    pub(crate) fn resize(&mut self, (width, height): (u32, u32)) {
        if width > 0 && height > 0 && (width, height) != self.size() {
            (self.config.width, self.config.height) = (width, height);
            self.surface.configure(&self.gpu.device, &self.config);
        }
    }

    /// Whether pictures wait for the screen, from now on.
    pub(crate) fn set_vsync(&mut self, vsync: bool) {
        let mode = present_mode(vsync);
        if self.config.present_mode != mode {
            self.config.present_mode = mode;
            self.surface.configure(&self.gpu.device, &self.config);
        }
    }

    /// Keeps the next picture in `file`. False while an earlier one is on its way.
    pub(crate) fn keep_picture(&mut self, file: PathBuf) -> bool {
        let free = self.keep.is_none() && self.kept.is_none() && self.saving.is_none();
        if free {
            self.keep = Some(file);
        }
        free
    }

    /// What became of a picture, once that is known.
    pub(crate) fn kept_picture(&mut self) -> Option<Result<PathBuf, String>> {
        let saving = self.saving.take_if(|saving| saving.is_finished())?;
        Some(saving.join().unwrap_or_else(|_| Err("writing it failed".to_owned())))
    }

    /// Waits until a picture that is on its way is written.
    pub(crate) fn finish(&mut self) -> Option<Result<PathBuf, String>> {
        while self.kept.is_some() && matches!(self.take_oldest(), Ok(true)) {}
        self.saving.take().map(|saving| saving.join().unwrap_or_else(|_| Err("writing it failed".to_owned())))
    }

    /// Shows the overlay's shapes alone.
    pub(crate) fn show_shapes(&mut self) {
        self.present(None);
    }

    /// Waits for the oldest picture under way; whether there was one is the answer.
    fn take_oldest(&mut self) -> Result<bool, ClientError> {
        let Some(taken) = self.reader.as_mut().map(PictureReader::take_oldest).transpose()?.flatten() else {
            return Ok(false);
        };
        if let Some(picture) = taken
            && let Some((_, file)) = self.kept.take_if(|(frame, _)| *frame == picture.frame)
        {
            let write = move || {
                let written = pictures::write(&file, &picture);
                written.map(|()| file.clone()).map_err(|error| format!("cannot write {}: {error}", file.display()))
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
            // Nobody sees it, or it comes later.
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
            // What was asked for before the window changed is kept in its new size.
            if let Some((_, file)) = self.kept.take() {
                self.keep = Some(file);
            }
            self.reader = Some(PictureReader::new(&self.gpu, width, height, PICTURES_AHEAD));
        }
        let Some(reader) = &mut self.reader else { return Ok(Shown::default()) };
        let target = reader.target();
        let keep = self.keep.take();
        let beside = self.beside.take();
        let submission = renderer.shade(camera, visibility_share, &target, |encoder| {
            if let Some((other, first_px)) = &beside {
                reader.replace_from(encoder, other, *first_px);
            }
            if keep.is_some() {
                reader.copy(encoder);
            }
        })?;
        reader.submitted(frame.0.into(), submission, keep.is_some());
        self.kept = keep.map(|file| (frame.0.into(), file)).or(self.kept.take());
        let shade = begun.elapsed();
        self.present(Some(&target));
        while self.reader.as_ref().is_some_and(PictureReader::is_full) {
            self.take_oldest()?;
        }
        Ok(Shown { shade, readback: begun.elapsed().saturating_sub(shade) })
    }
}

fn present_mode(vsync: bool) -> wgpu::PresentMode {
    if vsync { wgpu::PresentMode::AutoVsync } else { wgpu::PresentMode::AutoNoVsync }
}
