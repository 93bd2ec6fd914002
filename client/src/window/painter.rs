//! Paints a screen: the picture and the overlay over it. The target can be any view, so that a test can read it back.

use gnomon_shaders::gpu::Gpu;

use crate::render::{RenderError, present::PresentPass};

/// The overlay of one frame, as triangles.
#[derive(Default)]
pub(crate) struct Shapes {
    pub(crate) triangles: Vec<egui::ClippedPrimitive>,
    pub(crate) textures: egui::TexturesDelta,
    pub(crate) pixels_per_point: f32,
}

/// Paints views of one format.
pub(crate) struct Painter {
    gpu: Gpu,
    present: PresentPass,
    overlay: egui_wgpu::Renderer,
}

impl Painter {
    /// `format` must not be an sRGB format: pictures and overlay are already encoded.
    pub(crate) fn new(gpu: &Gpu, format: wgpu::TextureFormat) -> Result<Self, RenderError> {
        let options = egui_wgpu::RendererOptions { dithering: false, ..egui_wgpu::RendererOptions::default() };
        Ok(Self {
            gpu: gpu.clone(),
            present: PresentPass::new(gpu, format)?,
            overlay: egui_wgpu::Renderer::new(&gpu.device, format, options),
        })
    }

    /// Paints a screen of `size` pixels, and submits the work.
    pub(crate) fn paint(
        &mut self,
        screen: &wgpu::TextureView,
        size: (u32, u32),
        picture: Option<&wgpu::TextureView>,
        shapes: &mut Shapes,
    ) {
        let (device, queue) = (&self.gpu.device, &self.gpu.queue);
        let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let textures = std::mem::take(&mut shapes.textures);
        for (id, changes) in &textures.set {
            for change in changes {
                self.overlay.update_texture(device, queue, *id, change);
            }
        }
        let descriptor = egui_wgpu::ScreenDescriptor {
            size_in_pixels: [size.0, size.1],
            pixels_per_point: shapes.pixels_per_point.max(0.1),
        };
        let mut buffers = self.overlay.update_buffers(device, queue, &mut encoder, &shapes.triangles, &descriptor);
        {
            let mut pass = encoder
                .begin_render_pass(&wgpu::RenderPassDescriptor {
                    label: Some("screen"),
                    color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                        view: screen,
                        depth_slice: None,
                        resolve_target: None,
                        ops: wgpu::Operations {
                            load: wgpu::LoadOp::Clear(wgpu::Color::BLACK),
                            store: wgpu::StoreOp::Store,
                        },
                    })],
                    ..wgpu::RenderPassDescriptor::default()
                })
                .forget_lifetime();
            if let Some(picture) = picture {
                self.present.draw((device, queue), &mut pass, picture, size);
            }
            self.overlay.render(&mut pass, &shapes.triangles, &descriptor);
        }
        buffers.push(encoder.finish());
        queue.submit(buffers);
        for id in &textures.free {
            self.overlay.free_texture(id);
        }
    }
}
