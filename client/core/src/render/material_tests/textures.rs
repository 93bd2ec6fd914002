//! What textures and vertices make of a surface.

use glam::{DVec3, Vec2, Vec3, Vec4};
use gnomon_scene::{Coordinates, Filter, Image, Material, Specular, Texture, Wrap};

use super::*;

fn texture(image: u32) -> Texture {
    Texture::new(image, Wrap::ClampToEdge, Wrap::ClampToEdge)
}

/// A picture with the same colour everywhere.
fn image(rgba: [u8; 4]) -> Image {
    Image { encoded: Vec::new(), width: 1, height: 1, rgba: rgba.to_vec() }
}

#[test]
fn textures_multiply_their_factors() {
    let mut scene = card(Material {
        base_color: paint([230, 160, 80]),
        metallic: 1.0,
        roughness: 0.8,
        metallic_roughness_texture: Some(texture(0)),
        ..Material::default()
    });
    // Roughness 0.8 · 128/255, metallic 51/255; red and alpha are nothing's.
    scene.images.push(image([9, 128, 51, 7]));
    let expected =
        Expected { metallic: 0.2, roughness: f64::from(0.8_f32) * 128.0 / 255.0, ..Expected::of(&scene.materials[0]) };
    let light = light_of(&scene);
    for (place, _, eye) in seen() {
        let answer = expected.answer(DVec3::Z, toward(&scene), eye) * irradiance(&scene);
        assert_near(light[place], answer, "textured");
    }
}

#[test]
fn emission_is_seen_without_light_and_unlit_surfaces_with_any() {
    let mut glowing = card(Material {
        base_color: Vec4::new(0.0, 0.0, 0.0, 1.0),
        emissive: Vec3::new(2.0, 1.0, 0.5),
        emissive_texture: Some(texture(0)),
        specular: Specular { strength: 0.0, ..Specular::default() },
        ..Material::default()
    });
    // sRGB 188 is half of white; in light 0.5029.
    glowing.images.push(image([255, 188, 0, 255]));
    let half_of_white = f64::from(paint([188; 3]).x);
    let factor = f64::from(EMISSIVE);
    let light = light_of(&glowing);
    for (place, ..) in seen() {
        assert_near(light[place], DVec3::new(2.0, half_of_white, 0.0) * factor, "emission");
    }
    let unlit = card(Material { base_color: Vec4::new(0.25, 0.5, 1.0, 1.0), unlit: true, ..Material::default() });
    let light = light_of(&unlit);
    for (place, ..) in seen() {
        assert_near(light[place], DVec3::new(0.25, 0.5, 1.0), "unlit");
    }
}

#[test]
fn vertex_colours_multiply_the_base_colour() {
    let mut scene = card(Material { unlit: true, ..Material::default() });
    // From red on the left to blue on the right.
    scene.colors = vec![[65535, 0, 0, 65535], [0, 0, 65535, 65535], [0, 0, 65535, 65535], [65535, 0, 0, 65535]];
    let light = light_of(&scene);
    for (place, point, _) in seen() {
        let share = 0.5 + 0.5 * point.x;
        let expected = DVec3::new(1.0 - share, 0.0, share);
        assert!((light[place] - expected).abs().max_element() < 2e-3, "{}, expected {expected}", light[place]);
    }
}

/// A texel of a normal map that leans by 30° to the right and by some to the top.
const LEANING: [u8; 4] = [191, 160, 233, 255];

fn leaning(scale: f64) -> DVec3 {
    let [x, y, z] = [0, 1, 2].map(|channel| f64::from(LEANING[channel]) / 127.5 - 1.0);
    DVec3::new(x * scale, y * scale, z).normalize()
}

#[test]
fn normal_maps_turn_the_normal_with_and_without_tangents() {
    let material = || Material {
        base_color: paint([230, 160, 80]),
        roughness: 0.5,
        normal_texture: Some(texture(0)),
        normal_scale: 0.7,
        double_sided: true,
        ..Material::default()
    };
    let expected = Expected::of(&material());
    let mut derived = card(material());
    derived.images.push(image(LEANING));
    // Mirrored in x: u runs to the left. The derivatives follow; so do tangents, with the other hand.
    let mut mirrored = derived.clone();
    mirrored.uvs.iter_mut().for_each(|uv| uv.x = 1.0 - uv.x);
    let mut with_tangents = derived.clone();
    with_tangents.tangents = vec![Vec4::new(1.0, 0.0, 0.0, 1.0); 4];
    let mut mirrored_tangents = mirrored.clone();
    mirrored_tangents.tangents = vec![Vec4::new(-1.0, 0.0, 0.0, -1.0); 4];
    // Turned by a quarter: u runs upwards and v to the right, so that the picture's top is on the left.
    let mut turned = derived.clone();
    turned.uvs = [(0.0, 0.0), (0.0, 1.0), (1.0, 1.0), (1.0, 0.0)].map(|(u, v)| Vec2::new(u, v)).to_vec();
    let n = leaning(f64::from(0.7_f32));
    let to_the_left = DVec3::new(-n.x, n.y, n.z);
    let upwards = DVec3::new(-n.y, n.x, n.z);
    let cases = [
        ("derived", derived, n),
        ("with tangents", with_tangents, n),
        ("mirrored", mirrored, to_the_left),
        ("mirrored tangents", mirrored_tangents, to_the_left),
        ("turned", turned, upwards),
    ];
    for (name, scene, normal) in cases {
        let light = light_of(&scene);
        for (place, _, eye) in seen() {
            let answer = expected.answer(normal, toward(&scene), eye) * irradiance(&scene);
            assert_near(light[place], answer, name);
        }
    }
}

#[test]
fn the_back_of_a_bent_surface_is_the_front_turned_round() {
    let mut front =
        card(Material { roughness: 0.5, normal_texture: Some(texture(0)), double_sided: true, ..Material::default() });
    front.images.push(image(LEANING));
    // The same card seen from behind, and lit from there: its triangles turn the other way.
    let mut back = front.clone();
    back.triangles = vec![[0, 2, 1], [0, 3, 2]];
    back.normals = vec![Vec3::NEG_Z; 4];
    // Its front's map has u to the right as seen from the front, which is to the left from behind, and bends the normal
    // that is then reversed.
    let expected = Expected::of(&front.materials[0]);
    let lean = leaning(1.0);
    let reversed = -DVec3::new(lean.x, lean.y, -lean.z);
    let light = light_of(&back);
    for (place, _, eye) in seen() {
        let answer = expected.answer(reversed, toward(&back), eye) * irradiance(&back);
        assert_near(light[place], answer, "back");
    }
}

#[test]
fn occlusion_darkens_the_light_around_alone() {
    let gpu = gpu();
    let shade = |strength: f32, lit: bool| {
        let mut scene = card(Material {
            occlusion_texture: Some(texture(0)),
            occlusion_strength: strength,
            specular: Specular { strength: 0.0, ..Specular::default() },
            ..Material::default()
        });
        scene.images.push(image([51, 255, 255, 255]));
        scene.lights[0].intensity *= if lit { 1.0 } else { 0.0 };
        let exposure = Exposure { scale: 1.0, reference_lux: if lit { 0.0 } else { 1.0 } };
        let mut renderer =
            FrameRenderer::new(&gpu, &scene, (SIDE, SIDE), exposure, PICTURE_FORMAT, Predictor::None).unwrap();
        draw(&gpu, &mut renderer, &camera(), None);
        let bytes = texels(&gpu, &renderer.targets.light, wgpu::TextureAspect::All).unwrap();
        let halves: &[u16] = bytemuck::cast_slice(&bytes);
        half(halves[seen()[200].0 * 4])
    };
    // 51/255 is a fifth; at half strength, three fifths are left.
    let (open, half_shut, shut) = (shade(0.0, false), shade(0.5, false), shade(1.0, false));
    assert!((half_shut / open - 0.6).abs() < 0.01 && (shut / open - 0.2).abs() < 0.01, "{open} {half_shut} {shut}");
    assert_eq!(shade(0.0, true), shade(1.0, true));
}

#[test]
fn samplers_filter_as_the_file_says() {
    let magnified = |filter| {
        let mut scene = card(Material {
            base_color_texture: Some(Texture { magnified: filter, ..texture(0) }),
            unlit: true,
            ..Material::default()
        });
        let rgba = [[255, 255, 255, 255], [0, 0, 0, 255]].concat();
        scene.images.push(Image { encoded: Vec::new(), width: 2, height: 1, rgba });
        light_of(&scene)
    };
    let (hard, smooth) = (magnified(Filter::Nearest), magnified(Filter::Linear));
    let mut between = 0;
    for (place, point, _) in seen() {
        if point.x.abs() > 0.01 {
            assert_eq!(hard[place].x, if point.x < 0.0 { 1.0 } else { 0.0 });
        }
        let expected = (0.5 - point.x).clamp(0.0, 1.0);
        // Adapters weigh texels in steps of 1/256.
        assert!((smooth[place].x - expected).abs() < 0.01, "{} at {point}", smooth[place]);
        between += u32::from(expected > 0.1 && expected < 0.9);
    }
    assert!(between > 100);
}

#[test]
fn textures_lie_where_their_coordinates_say() {
    let mut scene = card(Material {
        emissive: Vec3::ONE,
        emissive_texture: Some(Texture {
            magnified: Filter::Nearest,
            // Turned by a quarter: u runs against the second v, shifted by 1.
            coordinates: Coordinates { second: true, map: [Vec3::new(0.0, -1.0, 1.0), Vec3::new(1.0, 0.0, 0.0)] },
            ..texture(0)
        }),
        unlit: false,
        base_color: Vec4::new(0.0, 0.0, 0.0, 1.0),
        specular: Specular { strength: 0.0, ..Specular::default() },
        ..Material::default()
    });
    scene.uvs_1 = scene.uvs.clone();
    scene.uvs = vec![Vec2::ZERO; 4];
    let rgba = [[255, 255, 255, 255], [0, 0, 0, 255]].concat();
    scene.images.push(Image { encoded: Vec::new(), width: 2, height: 1, rgba });
    let light = light_of(&scene);
    for (place, point, _) in seen() {
        if point.y.abs() > 0.01 {
            // v runs downwards: the second v is below ½ above the middle, where u is above ½, at the black texel.
            assert_eq!(light[place].x > 0.5, point.y < 0.0, "{point} {}", light[place]);
        }
    }
}
