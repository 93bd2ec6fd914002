//! Surfaces in one place, whether depth is drawn first or with them, and MASK surfaces without holes.

use glam::Vec4;
use gnomon_protocol::mask::MaskShape;
use gnomon_scene::{AlphaMode, Draw, Image, Material, Scene, Texture, Wrap};

use super::super::{
    gbuffer::GbufferPass,
    readback::texels,
    testing::{camera, floor_and_lights, gpu, renderer},
};

const SIZE: (u32, u32) = (96, 54);

/// Adds the wall's triangles once more, with another material.
fn add_wall(scene: &mut Scene, material: Material) {
    let first_triangle = u32::try_from(scene.triangles.len()).unwrap();
    let wall = [scene.triangles[2], scene.triangles[3]];
    scene.triangles.extend(wall);
    scene.materials.push(material);
    let material = u32::try_from(scene.materials.len() - 1).unwrap();
    scene.draws.push(Draw { first_triangle, triangles: 2, material });
}

/// One texel with this alpha.
fn picture(scene: &mut Scene, alpha: u8) -> Option<Texture> {
    scene.images.push(Image { encoded: Vec::new(), width: 1, height: 1, rgba: vec![255, 255, 255, alpha] });
    let image = u32::try_from(scene.images.len() - 1).unwrap();
    Some(Texture::new(image, Wrap::Repeat, Wrap::Repeat))
}

/// How many pixels show each material. The G-buffer is the same to the last bit, whether depth comes first or not.
fn seen(scene: &Scene) -> Vec<u32> {
    let gpu = gpu();
    let lights = u32::try_from(scene.lights.len()).unwrap();
    let mut renderer = renderer(&gpu, scene, MaskShape::new(SIZE.0, SIZE.1, lights).unwrap());
    let drawn = [false, true].map(|depth_first| {
        let surfaces = (&renderer.scene, renderer.predict.depth_pass());
        renderer.gbuffer = GbufferPass::new(&gpu, renderer.view.buffer(), surfaces, depth_first).unwrap();
        renderer.draw_surfaces(&camera(SIZE.0, SIZE.1)).unwrap();
        let words = texels(&gpu, &renderer.targets.normal_material, wgpu::TextureAspect::All).unwrap();
        (words, texels(&gpu, renderer.history.view(), wgpu::TextureAspect::DepthOnly).unwrap())
    });
    assert!(drawn[0] == drawn[1], "depth first draws other surfaces");
    let words: &[[u32; 4]] = bytemuck::cast_slice(&drawn[0].0);
    let mut seen = vec![0; scene.materials.len() + 1];
    words.iter().for_each(|word| seen[(word[1] & 0xffff) as usize] += 1);
    seen
}

#[test]
fn of_surfaces_in_one_place_the_first_is_seen_and_holes_show_the_other() {
    let alone = seen(&floor_and_lights());
    let other = Material { base_color: Vec4::new(0.1, 0.8, 0.1, 1.0), double_sided: true, ..Material::default() };
    // OPAQUE ones by their order.
    let mut scene = floor_and_lights();
    add_wall(&mut scene, other.clone());
    assert_eq!(seen(&scene), [alone[0], alone[1], alone[2], 0]);
    // MASK ones after them, solid or not.
    for alpha in [0, 255] {
        let mut scene = floor_and_lights();
        let base_color_texture = picture(&mut scene, alpha);
        let masked = Material { alpha: AlphaMode::Mask { cutoff: 0.5 }, base_color_texture, ..other.clone() };
        add_wall(&mut scene, masked);
        let with_holes = seen(&scene);
        let walls = with_holes[2] + with_holes[3];
        assert_eq!((with_holes[0], with_holes[1], walls), (alone[0], alone[1], alone[2]), "{alpha}");
        assert!(alpha == 255 || with_holes[3] == 0, "holes are seen");
    }
}

#[test]
fn a_mask_surface_is_tested_only_if_it_has_holes() {
    let masked = |alpha: u8, factor: f32, cutoff: f32| {
        let mut scene = floor_and_lights();
        scene.materials[1].base_color_texture = picture(&mut scene, alpha);
        scene.materials[1].base_color.w = factor;
        scene.materials[1].alpha = AlphaMode::Mask { cutoff };
        let alone = seen(&scene)[2];
        let gpu = gpu();
        let renderer = renderer(&gpu, &scene, MaskShape::new(SIZE.0, SIZE.1, 2).unwrap());
        (alone > 0, renderer.scene.batches.iter().filter(|batch| batch.is_masked()).count())
    };
    assert_eq!(masked(255, 1.0, 0.5), (true, 0));
    assert_eq!(masked(128, 1.0, 0.5), (true, 0));
    assert_eq!(masked(200, 0.5, 0.5), (false, 1));
    assert_eq!(masked(127, 1.0, 0.5), (false, 1));
    // Where rounding decides, every pixel is asked.
    assert_eq!(masked(255, 0.5, 0.5), (true, 1));
}
