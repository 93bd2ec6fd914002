//! What stands on the screen is what a headless run would have written.

use gnomon_protocol::mask::{Mask, MaskShape};

use super::painter::{Painter, Shapes};
use crate::{
    input::{Controls, fly::Fly, keys::MoveKey},
    render::{
        debug_view::DebugView,
        predict::MaskView,
        readback::{PictureReader, texels},
        testing::{camera, draw, floor_and_lights, gpu, renderer},
    },
};

const SIZE: (u32, u32) = (96, 54);

fn mask() -> Mask {
    let mut mask = Mask::new(MaskShape::new(SIZE.0, SIZE.1, 2).unwrap());
    for (index, word) in mask.words_mut().iter_mut().enumerate() {
        *word = 0x9E37_79B9_7F4A_7C15_u64.wrapping_mul(index as u64 + 1);
    }
    mask
}

/// A screen that a test can look at, as RGBA.
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
fn a_picture_on_the_screen_has_every_byte_of_a_headless_one() {
    let gpu = gpu();
    let (scene, mask) = (floor_and_lights(), mask());
    let camera = camera(SIZE.0, SIZE.1);
    let headless = draw(&gpu, &mut renderer(&gpu, &scene, mask.shape()), &camera, Some(&mask));

    // A window's renderer has been of another size, and has shown other things.
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
    windowed.set_mask(Some(MaskView { mask: &mask, coverage: None, more: false, traced_for: &camera })).unwrap();
    windowed.shade(&camera, 1.0, &reader.target(), |_| ()).unwrap();
    assert!(on_screen(&gpu, &reader.target(), SIZE) == headless.rgba, "the screen shows other bytes");

    // Larger screens show it whole, in the middle.
    let wide = on_screen(&gpu, &reader.target(), (SIZE.0 + 40, SIZE.1));
    assert_eq!(wide[..4], [0, 0, 0, 255]);
    let (row, margin) = ((SIZE.0 as usize + 40) * 4, 20 * 4);
    assert_eq!(wide[margin..row - margin], headless.rgba[..SIZE.0 as usize * 4]);
}

#[test]
fn lights_split_and_views_change_what_they_say_and_nothing_else() {
    let gpu = gpu();
    let (scene, mask) = (floor_and_lights(), mask());
    let camera = camera(SIZE.0, SIZE.1);
    let mut one = renderer(&gpu, &scene, mask.shape());
    let plain = draw(&gpu, &mut one, &camera, Some(&mask));
    let lit = draw(&gpu, &mut one, &camera, None);
    one.set_split(Some(SIZE.0 / 2));
    let split = draw(&gpu, &mut one, &camera, Some(&mask));
    let half = SIZE.0 as usize * 2;
    let rows = |picture: &[u8]| picture.chunks(half * 2).map(<[u8]>::to_vec).collect::<Vec<_>>();
    for ((plain, lit), split) in rows(&plain.rgba).iter().zip(rows(&lit.rgba)).zip(rows(&split.rgba)) {
        assert_eq!((&split[..half], &split[half..]), (&plain[..half], &lit[half..]));
    }
    one.set_split(None);
    one.set_lights_on(0);
    let dark = draw(&gpu, &mut one, &camera, Some(&mask));
    assert!(dark.rgba != plain.rgba);
    one.set_lights_on(u32::MAX);
    let views = [DebugView::Light(0), DebugView::Light(1), DebugView::Unknown, DebugView::Depth, DebugView::Normals];
    let mut seen = vec![plain.rgba.clone()];
    for view in views {
        one.set_debug_view(view);
        seen.push(draw(&gpu, &mut one, &camera, Some(&mask)).rgba);
    }
    for (index, picture) in seen.iter().enumerate() {
        assert!(!seen[..index].contains(picture), "view {index} shows what another one shows");
    }
    one.set_debug_view(DebugView::Picture);
    assert_eq!(draw(&gpu, &mut one, &camera, Some(&mask)).rgba, plain.rgba);
}

#[test]
fn a_light_s_view_is_its_plane_of_the_mask() {
    let gpu = gpu();
    let (scene, mask) = (floor_and_lights(), mask());
    let camera = camera(SIZE.0, SIZE.1);
    let mut one = renderer(&gpu, &scene, mask.shape());
    one.set_debug_view(DebugView::Light(1));
    let picture = draw(&gpu, &mut one, &camera, Some(&mask));
    let mut surfaces = 0;
    for (index, [red, _, blue, _]) in (0..).zip(picture.rgba.as_chunks::<4>().0) {
        // Yellow where the light reaches, blue where it does not, black where nothing is.
        if (*red, *blue) != (0, 0) {
            surfaces += 1;
            assert_eq!(red > blue, mask.get(1, index % SIZE.0, index / SIZE.0), "pixel {index}");
        }
    }
    assert!(surfaces > 500, "{surfaces}");
}

#[test]
fn a_press_between_two_frames_is_in_the_very_next_one() {
    let mut controls = Controls::default();
    let mut fly = Fly::from_camera(&camera(SIZE.0, SIZE.1), 1.0);
    let before = fly.camera(SIZE.0, SIZE.1);
    fly.step(&controls.take(0.016, 54.0), 0.016);
    assert_eq!(fly.camera(SIZE.0, SIZE.1), before);
    controls.held.set(MoveKey::Forward, true);
    fly.step(&controls.take(0.016, 54.0), 0.016);
    assert!(fly.camera(SIZE.0, SIZE.1) != before);
}
