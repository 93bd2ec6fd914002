//! The screen shows what a headless run would have written.

use gnomon_protocol::mask::{Mask, MaskShape};

use super::painter::{Painter, Shapes};
use crate::render::{
    debug_view::DebugView,
    predict::MaskView,
    readback::{PictureReader, texels},
    testing::{camera, draw, floor_and_lights, gpu, renderer},
};

const SIZE: (u32, u32) = (96, 54);

fn mask() -> Mask {
    let mut mask = Mask::new(MaskShape::new(SIZE.0, SIZE.1, 2).unwrap());
    for (index, word) in mask.words_mut().iter_mut().enumerate() {
        *word = 0x9E37_79B9_7F4A_7C15_u64.wrapping_mul(index as u64 + 1);
    }
    mask
}

/// Reads back a painted screen as RGBA.
fn on_screen(gpu: &gnomon_shaders::gpu::Gpu, picture: &wgpu::TextureView, (width, height): (u32, u32)) -> Vec<u8> {
    let format = wgpu::TextureFormat::Bgra8Unorm;
    let screen = gpu.device.create_texture(&wgpu::TextureDescriptor {
        label: Some("screen"),
        size: wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format,
        usage: wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::COPY_SRC,
        view_formats: &[],
    });
    let view = screen.create_view(&wgpu::TextureViewDescriptor::default());
    let mut shapes = Shapes { pixels_per_point: 1.0, ..Shapes::default() };
    Painter::new(gpu, format).unwrap().paint(&view, (width, height), Some(picture), &mut shapes);
    let bgra = texels(gpu, &view, wgpu::TextureAspect::All).unwrap();
    bgra.as_chunks::<4>().0.iter().flat_map(|[b, g, r, a]| [*r, *g, *b, *a]).collect()
}

#[test]
fn a_picture_on_the_screen_equals_a_headless_one() {
    let gpu = gpu();
    let (scene, mask) = (floor_and_lights(), mask());
    let camera = camera(SIZE.0, SIZE.1);
    let headless = draw(&gpu, &mut renderer(&gpu, &scene, mask.shape()), &camera, Some(&mask));

    // The window's renderer had another size and other settings before.
    let mut windowed = renderer(&gpu, &scene, MaskShape::new(64, 64, 2).unwrap());
    windowed.draw_surfaces(&camera).unwrap();
    windowed.set_lights_on(0b10);
    windowed.set_split(Some(20));
    windowed.set_debug_view(DebugView::Depth);
    windowed.resize(SIZE).unwrap();
    windowed.set_lights_on(0b11);
    windowed.set_split(None);
    windowed.set_debug_view(DebugView::Picture);
    let reader = PictureReader::new(&gpu, SIZE.0, SIZE.1, 1);
    windowed.draw_surfaces(&camera).unwrap();
    windowed
        .set_mask(Some(MaskView {
            mask: &mask,
            coverage: None,
            more: false,
            traced_for: &camera,
            scene: &gnomon_scene::SceneAt::default(),
        }))
        .unwrap();
    windowed.shade(&camera, 1.0, &reader.target(), |_| ()).unwrap();
    assert!(on_screen(&gpu, &reader.target(), SIZE) == headless.rgba, "the screen shows other bytes");

    // Larger screens show it whole and centred.
    let wide = on_screen(&gpu, &reader.target(), (SIZE.0 + 40, SIZE.1));
    assert_eq!(wide[..4], [0, 0, 0, 255]);
    let (row, margin) = ((SIZE.0 as usize + 40) * 4, 20 * 4);
    assert_eq!(wide[margin..row - margin], headless.rgba[..SIZE.0 as usize * 4]);
}
